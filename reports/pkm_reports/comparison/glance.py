"""What differs between results, in sentences and in one table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from oed.result import StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Items, Paragraph, Table, TableColumn
from pkm_reports.sections import is_plan, used_setups

Results = Mapping[str, StudyResult]
#: ratio from which two accuracies or times differ
DIFFERS: Final = 1.02


def sentences(results: Results) -> list[Block]:
    """Differences of machine, time, rank and accuracy; that there are none, if so."""
    agreement = "The results agree in machine, time, rank and predicted accuracy."
    lines = [*_machines(results), *_times(results), *_ranks(results), *_best(results)]
    return [Items(lines)] if lines else [Paragraph(agreement)]


def minutes(result: StudyResult) -> float:
    """Time of the plan; NaN where there is none."""
    design, plan = result.design, result.plan
    if not is_plan(result):
        return math.nan
    if design is not None and design.order is not None:
        return design.order.minutes
    if design is not None and design.cost_min is not None:
        return design.cost_min
    return math.nan if plan is None else plan.cost


def _machines(results: Results) -> Iterator[str]:
    machines = {r.machine.name for r in results.values()}
    if len(machines) > 1:
        yield "The machines differ, so parameters are not compared."


def _times(results: Results) -> Iterator[str]:
    times = {n: minutes(r) for n, r in results.items() if math.isfinite(minutes(r))}
    if len(times) < 2:
        return
    short, long = min(times, key=lambda n: times[n]), max(times, key=lambda n: times[n])
    if times[long] > DIFFERS * times[short]:
        yield (
            f"{short} takes the least time, {text.quantity(times[short], 'min', 2)},"
            f" and {long} the most, {text.quantity(times[long], 'min', 2)}."
        )


def _ranks(results: Results) -> Iterator[str]:
    ranks = {
        name: r.identifiability.rank
        for name, r in results.items()
        if r.identifiability is not None
    }
    if len(set(ranks.values())) > 1:
        counts = [f"{rank} in {name}" for name, rank in ranks.items()]
        yield f"Directions that the readings determine: {text.listing(counts)}."


def _best(results: Results) -> Iterator[str]:
    """For each component which result is the most accurate, and by how much."""
    uncorrected = _uncorrected(results)
    for name, sizes in rms_by_component(results).items():
        if len(sizes) < 2:
            continue
        best = min(sizes, key=lambda n: sizes[n][0])
        worst = max(sizes, key=lambda n: sizes[n][0])
        (low, unit), (high, other) = sizes[best], sizes[worst]
        if unit != other or not high > DIFFERS * low > 0.0:
            continue
        noun = "unknown part" if name in uncorrected else "error"
        subject = f"The {noun} of {name}"
        yield (
            f"{subject} is smallest in {best}: {text.quantity(low, unit)} rms,"
            f" {text.number(high / low, 2)} times as good as in {worst}."
        )


def _uncorrected(results: Results) -> set[str]:
    """Components that the controller of any of the machines does not correct."""
    predictions = [r.judged_prediction for r in results.values()]
    return {
        name
        for prediction in predictions
        if prediction is not None
        for name, component in prediction.components.items()
        if not component.compensatable
    }


def rms_by_component(results: Results) -> dict[str, dict[str, tuple[float, str]]]:
    """Predicted rms afterwards and its unit, by component and result.

    Of what the controller does not correct, the unknown part.
    """
    sizes: dict[str, dict[str, tuple[float, str]]] = {}
    for label, result in results.items():
        prediction = result.judged_prediction
        if prediction is None:
            continue
        for name, c in prediction.components.items():
            sizes.setdefault(name, {})[label] = (c.judged.rms, c.judged.unit)
    return sizes


# -- table -----------------------------------------------------------------------------


def _study(result: StudyResult) -> str:
    return result.title or result.study


def _readings(result: StudyResult) -> str:
    if result.design is not None:
        return str(result.design.n)
    if result.estimate is not None:
        return str(result.estimate.readings)
    stages = [] if result.plan is None else result.plan.stages
    return str(sum(stage.readings for stage in stages)) if stages else text.MISSING


def _setups(result: StudyResult) -> str:
    setups = used_setups(result)
    return text.listing(f"{s.name} ({s.instrument})" for s in setups)


def _time(result: StudyResult) -> str:
    return text.quantity(minutes(result), "min", 2)


def _determined(result: StudyResult) -> str:
    section = result.identifiability
    return text.MISSING if section is None else f"{section.rank} of {section.n}"


def _certificate(result: StudyResult) -> str:
    design = result.design
    if design is None or design.efficiency is None:
        return text.MISSING
    share = text.percent_at_least(design.efficiency)
    return f"{design.criterion}: at least {share} of the best"


def _residual(result: StudyResult) -> str:
    estimate = result.final_estimate
    if estimate is None:
        return text.MISSING
    rms = estimate.rms_after
    return text.listing(
        f"{name} {text.channel_value(name, value, estimate.units)}"
        for name, value in rms.items()
    )


def _claims(result: StudyResult) -> str:
    if not result.claims:
        return text.MISSING
    met = sum(claim.met for claim in result.claims)
    return f"{met} of {len(result.claims)} met"


def _warnings(result: StudyResult) -> str:
    return str(len(result.warnings))


ROWS: Final[tuple[tuple[str, Callable[[StudyResult], str]], ...]] = (
    ("Study", _study),
    ("Machine", lambda result: result.machine.name),
    ("Set-ups", _setups),
    ("Readings", _readings),
    ("Time", _time),
    ("Determined", _determined),
    ("Certificate", _certificate),
    ("Residual after the fit, rms", _residual),
    ("Claims", _claims),
    ("Warnings", _warnings),
)


def blocks(results: Results) -> list[Block]:
    """One row a fact, one column a result; rows without a fact are left out."""
    rows = []
    for title, cell in ROWS:
        cells = [cell(result) for result in results.values()]
        if any(words != text.MISSING for words in cells):
            rows.append([title, *cells])
    columns = [TableColumn("What"), *[TableColumn(name, wide=True) for name in results]]
    return [Table(columns, rows, f"{len(results)} results side by side.")]
