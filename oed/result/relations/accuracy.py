"""Relations of what is predicted and confirmed: accuracy, budget, acceptance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from oed.result.acceptance import AcceptanceSection, VerificationSection
from oed.result.adjustment import AdjustmentSection
from oed.result.budget import BudgetSection
from oed.result.forecast import ForecastSection
from oed.result.mixture import MixtureSection
from oed.result.prediction import MapPoint, PredictionSection, SpreadRecord
from oed.result.relations import base
from oed.result.relations.base import Breach
from oed.result.study import StudyResult

REFERENCES = ("home", "absolute", "best_fit")
#: figures of drawn machines
DRAWN = ("rms", "p95", "max", "rms_interval", "p95_interval", "max_interval")
MODES = ("plan", "identified", "corrected", "mixture")


def breaches(result: StudyResult) -> Iterator[Breach]:
    """Contradictions of the sections about accuracy."""
    if result.prediction is not None:
        yield from _prediction("prediction", result.prediction)
    corrected = result.corrected
    for name, fitted in (("estimate", result.estimate), ("corrected", corrected)):
        if fitted is not None:
            known, of = fitted.parameters, f"{name}.parameters"
            yield from base.known(f"{name}.controller", fitted.controller, known, of)
    if corrected is not None and corrected.prediction is not None:
        field = "corrected.prediction"
        yield from _prediction(field, corrected.prediction)
        of = f"{field}.components"
        alone = corrected.parameters_only
        yield from base.same_names(
            "corrected.parameters_only", alone, corrected.prediction.components, of
        )
        yield from _spreads("corrected.parameters_only", alone)
    mixture = None if result.gap is None else result.gap.mixture
    if mixture is not None:
        yield from _mixture(mixture)
    if result.acceptance is not None:
        yield from _acceptance(result.acceptance)
    if result.verification is not None:
        yield from _verification(result.verification)
    if result.adjustment is not None:
        yield from _adjustment(result.adjustment)
    if result.forecast is not None:
        yield from _forecast(result.forecast)


def _mixture(section: MixtureSection) -> Iterator[Breach]:
    field, count = "gap.mixture", len(section.parameters)
    of = f"{field}.parameters"
    yield from base.table(f"{field}.covariance", section.covariance, of, count, count)
    yield from base.known(
        f"{field}.controller", section.controller, section.parameters, of
    )
    for name, parameter in section.parameters.items():
        yield from base.within(
            f"{of}.{name}.within", parameter.within, 0.0, base.LARGEST
        )
    for k, answer in enumerate(section.answers, start=1):
        at = f"{field}.answers[{k}].probability"
        yield from base.within(at, answer.probability, 0.0, 1.0)
    for part in ("prediction", "with_effects"):
        prediction = getattr(section, part)
        if prediction is not None:
            yield from _prediction(f"{field}.{part}", prediction)
    for k, choice in enumerate(section.choices, start=1):
        at = f"{field}.choices[{k}].rms"
        if section.prediction is not None:
            names, of = section.prediction.components, f"{field}.prediction.components"
            yield from base.same_names(at, choice.rms, names, of)


def _prediction(field: str, section: PredictionSection) -> Iterator[Breach]:
    names, of = section.components, f"{field}.components"
    yield from base.known(
        f"{field}.reference", [section.reference], REFERENCES, "its values"
    )
    yield from base.known(f"{field}.mode", [section.mode], MODES, "its values")
    yield from base.same_names(f"{field}.unit", section.unit, names, of)
    for name, component in names.items():
        at = f"{of}.{name}"
        for part in ("before", "after", "known"):
            spread: SpreadRecord = getattr(component, part)
            yield from _spreads(f"{at}.{part}", {"": spread})
            if name in section.unit and spread.unit != section.unit[name]:
                other = section.unit[name]
                problem = f"{spread.unit}, where {field}.unit has {other}"
                yield Breach(f"{at}.{part}.unit", problem)
    for part in ("realised_share", "wanted", "worst"):
        yield from base.known(f"{field}.{part}", getattr(section, part), names, of)
    if section.realised is not None:
        yield from base.known(f"{field}.realised", section.realised, names, of)
        yield from _spreads(f"{field}.realised", section.realised)
    for reference, spreads in section.references.items():
        at = f"{field}.references.{reference}"
        yield from base.same_names(at, spreads, names, of)
        yield from _spreads(at, spreads)
    for k, tool in enumerate(section.tools, start=1):
        at = f"{field}.tools[{k}]"
        yield from base.same_names(f"{at}.components", tool.components, names, of)
        yield from _spreads(f"{at}.components", tool.components)
    yield from _map(field, section)
    if section.budget is not None:
        yield from _budget(f"{field}.budget", section.budget, section)


def _map(field: str, section: PredictionSection) -> Iterator[Breach]:
    places: dict[str, MapPoint] = {
        f"{field}.map[{k}]": point for k, point in enumerate(section.map, start=1)
    }
    places |= {f"{field}.worst.{name}": point for name, point in section.worst.items()}
    of = f"{field}.components"
    for at, point in places.items():
        for part in ("before", "after"):
            errors = getattr(point, part)
            yield from base.same_names(f"{at}.{part}", errors, section.components, of)
        if point.at:
            yield from base.lengths(f"{at}.at", point.at, "a point", 3)
    yield from base.same_keys(f"{field}.map", [p.command for p in section.map])
    with_place = [bool(point.at) for point in section.map]
    if any(with_place) and not all(with_place):
        first = with_place.index(False) + 1
        yield Breach(f"{field}.map[{first}].at", "missing, which other poses have")


def _budget(
    field: str, section: BudgetSection, prediction: PredictionSection
) -> Iterator[Breach]:
    of = f"{field}.predicted"
    names = section.predicted
    yield from base.known(
        of, names, prediction.components, "the prediction's components"
    )
    for k, line in enumerate(section.lines, start=1):
        at = f"{field}.lines[{k}]"
        for part in ("share", "size", "without", "halved"):
            values = getattr(line, part)
            if values is not None:
                yield from base.same_names(f"{at}.{part}", values, names, of)
    for k, effect in enumerate(section.unmodelled, start=1):
        at = f"{field}.unmodelled[{k}]"
        for part in ("size", "with_it"):
            yield from base.same_names(f"{at}.{part}", getattr(effect, part), names, of)
        # results of older versions have no sizes by decades
        if effect.far:
            yield from base.same_names(f"{at}.far", effect.far, names, of)
    usual = section.usual
    if usual is not None:
        for part in ("unmodelled", "fitted"):
            at = f"{field}.usual.{part}"
            yield from base.known(at, getattr(usual, part), names, of)


def _spreads(field: str, spreads: Mapping[str, SpreadRecord]) -> Iterator[Breach]:
    for name, spread in spreads.items():
        at = f"{field}.{name}" if name else field
        for part in ("rms", "p95", "max"):
            value = getattr(spread, part)
            yield from base.within(f"{at}.{part}", value, 0.0, base.LARGEST)
        names = spread.monte_carlo
        yield from base.known(f"{at}.monte_carlo", names, DRAWN, "its names")
        for figure, errors in names.items():
            ends = 2 if figure.endswith("_interval") else 1
            field = f"{at}.monte_carlo.{figure}"
            yield from base.lengths(field, errors, "the figure", ends)


def _acceptance(section: AcceptanceSection) -> Iterator[Breach]:
    if not section.poses:
        yield Breach("acceptance.poses", "there is none")
    yield from base.same_keys("acceptance.poses", section.poses)


def _verification(section: VerificationSection) -> Iterator[Breach]:
    of = "verification.components"
    yield from base.known(
        "verification.positioning", section.positioning, section.components, of
    )


def _adjustment(section: AdjustmentSection) -> Iterator[Breach]:
    count = len(section.lines) + 1
    yield from base.lengths(
        "adjustment.accuracy",
        section.accuracy,
        "the list of lines with the start",
        count,
    )
    for k, record in enumerate(section.accuracy, start=1):
        at = f"adjustment.accuracy[{k}]"
        for part in ("corrected", "plain"):
            errors = getattr(record, part)
            yield from base.same_names(
                f"{at}.{part}", errors, section.unit, "adjustment.unit"
            )


def _forecast(section: ForecastSection) -> Iterator[Breach]:
    if not section.nodes:
        yield Breach("forecast.nodes", "there is none")
    yield from base.same_keys("forecast.nodes", section.nodes)
