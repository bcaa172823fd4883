"""Relations of what is identified: estimate, posterior, corrected estimate, noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from oed.result.corrected import CorrectedSection, EffectTable
from oed.result.fit import (
    EstimateSection,
    ParameterEstimate,
    PosteriorSection,
    RunCurve,
)
from oed.result.prediction import HeldOutSection
from oed.result.relations import base
from oed.result.relations.base import Breach
from oed.result.study import StudyResult

#: kinds of runs that have curves
RUN_KINDS = ("circle", "line")


def breaches(result: StudyResult) -> Iterator[Breach]:
    """Contradictions of the sections that readings make."""
    if result.estimate is not None:
        yield from _estimate(result.estimate)
    if result.posterior is not None:
        yield from _posterior(result.posterior)
    if result.corrected is not None:
        yield from _corrected(result.corrected)
    for k, section in enumerate(result.held_out, start=1):
        yield from _held_out(f"held_out[{k}]", section)
    for k, curve in enumerate(result.after_compensation, start=1):
        yield from run_curve(f"after_compensation[{k}]", curve)


def _estimate(section: EstimateSection) -> Iterator[Breach]:
    yield from _fitted("estimate", section)
    yield from base.within("estimate.chi2", section.chi2, 0.0, base.LARGEST)
    channels = section.channels
    of = "estimate.units"
    yield from base.known("estimate.channels", set(channels), section.units, of)
    for name in ("residuals", "residuals_before"):
        values = getattr(section, name)
        yield from base.lengths(
            f"estimate.{name}", values, "estimate.channels", len(channels)
        )
    for name in ("rms_before", "rms_after"):
        yield from base.known(
            f"estimate.{name}", getattr(section, name), section.units, of
        )
    yield from base.same_names(
        "estimate.rms_after",
        section.rms_after,
        section.rms_before,
        "estimate.rms_before",
    )
    for k, combination in enumerate(section.combinations, start=1):
        field = f"estimate.combinations[{k}]"
        of_parameters = "estimate.parameters"
        yield from base.known(
            f"{field}.terms", combination.terms, section.parameters, of_parameters
        )
    yield from base.same_keys("estimate.commands", section.commands)
    for k, curve in enumerate(section.runs, start=1):
        yield from run_curve(f"estimate.runs[{k}]", curve)


def run_curve(field: str, curve: RunCurve) -> Iterator[Breach]:
    """Contradictions of the readings along a run."""
    yield from base.known(f"{field}.kind", [curve.kind], RUN_KINDS, "its values")
    for name in ("measured", "predicted", "half_widths"):
        values = getattr(curve, name)
        yield from base.lengths(f"{field}.{name}", values, f"{field}.at", len(curve.at))
    count = len(curve.at) if curve.compensated else 0
    for name in ("compensated", "compensated_half_widths"):
        values = getattr(curve, name)
        yield from base.lengths(f"{field}.{name}", values, f"{field}.at", count)


def _fitted(
    field: str, section: EstimateSection | CorrectedSection
) -> Iterator[Breach]:
    """Parameters with their covariance, and the channels' units."""
    yield from _parameters(f"{field}.parameters", section.parameters)
    yield from base.within(f"{field}.dof", section.dof, -base.LARGEST, base.LARGEST)
    if section.covariance:
        count = len(section.parameters)
        at, of = f"{field}.covariance", f"{field}.parameters"
        yield from base.table(at, section.covariance, of, count, count)


def _parameters(
    field: str, parameters: Mapping[str, ParameterEstimate]
) -> Iterator[Breach]:
    for name, parameter in parameters.items():
        yield from base.within(f"{field}.{name}.sd", parameter.sd, 0.0, base.LARGEST)
        yield from base.within(
            f"{field}.{name}.prior_sd", parameter.prior_sd, 0.0, base.LARGEST
        )


def _posterior(section: PosteriorSection) -> Iterator[Breach]:
    width = len(section.directions)
    height = len(section.corner)
    yield from base.table(
        "posterior.corner", section.corner, "posterior.directions", height, width
    )


def _corrected(section: CorrectedSection) -> Iterator[Breach]:
    yield from _fitted("corrected", section)
    of = "corrected.units"
    yield from base.known("corrected.rms_after", section.rms_after, section.units, of)
    for name, effect in section.effects.items():
        field = f"corrected.effects.{name}"
        of = "corrected.constants"
        yield from base.known(f"{field}.effect", [effect.effect], section.constants, of)
    for k, table in enumerate(section.tables, start=1):
        yield from _effect_table(f"corrected.tables[{k}]", table)


def _effect_table(field: str, table: EffectTable) -> Iterator[Breach]:
    yield from base.lengths(
        f"{field}.table", table.table, f"{field}.values", len(table.values)
    )
    height, width = len(table.commands), len(table.joints)
    for k, rows in enumerate(table.table, start=1):
        other = f"{field}.commands x joints"
        yield from base.table(f"{field}.table[{k}]", rows, other, height, width)
    yield from base.same_keys(f"{field}.commands", table.commands)


def _held_out(field: str, section: HeldOutSection) -> Iterator[Breach]:
    for name in ("residuals", "half_widths"):
        values = getattr(section, name)
        yield from base.lengths(f"{field}.{name}", values, f"{field}.n", section.n)
