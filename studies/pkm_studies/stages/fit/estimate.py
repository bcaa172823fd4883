"""Reports the identified parameters and the residuals: the section `estimate`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from oed import units
from oed.base import Array
from oed.estimation import Estimate
from oed.identifiability import Identifiability
from oed.measurement import Measurement, Series
from oed.result import (
    CombinationEstimate,
    EstimateSection,
    HeldParameter,
    ParameterEstimate,
)
from oed.text import format_p_value, rounded
from pkm_studies.describe import displayed_command


def estimate_section(
    measurement: Measurement,
    series: Sequence[Series],
    estimate: Estimate,
    truth: Array | None,
) -> EstimateSection:
    """Parameters in display units, residuals in the fine unit of their channel.

    `truth` (n,) are the parameters of a virtual machine, SI.
    """
    channels = [
        channel
        for s in series
        for _ in range(len(s))
        for channel in measurement.setups[s.setup].instrument.channels
    ]
    fine = {c.name: units.FINE[c.unit] for c in channels}
    factor = np.array([units.factor(fine[c.name]) for c in channels])
    names = np.array([c.name for c in channels])
    after, before = estimate.residuals / factor, estimate.residuals_before / factor
    rounds = [
        {"rms_before": r.rms_before, "rms_after": r.rms_after} for r in estimate.stages
    ]
    return EstimateSection(
        parameters=_parameters(measurement, estimate, truth),
        rms_before=_rms_by_channel(before, names),
        rms_after=_rms_by_channel(after, names),
        units=fine,
        channels=[str(n) for n in names],
        readings=len(after),
        dof=estimate.dof,
        chi2=estimate.chi2,
        iterations=rounds,
        warnings=list(estimate.warnings),
        residuals=[float(v) for v in after],
        residuals_before=[float(v) for v in before],
        covariance=_covariance(measurement, estimate),
        commands=_commands(measurement, series),
    )


def add_held(section: EstimateSection, fixed: list[HeldParameter]) -> EstimateSection:
    """The section with held parameters that the readings contradict, as warnings."""
    sentences = [_held_sentence(one) for one in fixed]
    return replace(section, held=fixed, warnings=[*sentences, *section.warnings])


def _held_sentence(one: HeldParameter) -> str:
    names = " and ".join(one.parameters)
    together = " together" if len(one.parameters) > 1 else ""
    changes = [
        f"{name} by {rounded(value)} {one.units[name]}"
        for name, value in one.changes.items()
    ]
    return (
        f"{names} {'is' if not together else 'are'} held at {one.held:.5g} {one.unit},"
        f" which the readings contradict (p {format_p_value(one.p_value)}): freed{together},"
        f" {one.estimate:.5g} ± {rounded(one.sd)} {one.unit}, with changes of"
        f" {', '.join(changes)}, and of the tool by {rounded(one.tool_mm)} mm rms at the"
        " poses read"
    )


def _commands(
    measurement: Measurement, series: Sequence[Series]
) -> list[dict[str, float]]:
    """The commands that were read or read against, each once; none where only joints
    are known.
    """
    commands = np.unique(np.vstack([s.command for s in series]), axis=0)
    finite = commands[np.isfinite(commands).all(axis=1)]
    return [displayed_command(measurement.machine, c) for c in finite]


def _parameters(
    measurement: Measurement, estimate: Estimate, truth: Array | None
) -> dict[str, ParameterEstimate]:
    """Each parameter that is not fixed, in its display unit."""
    parameters = {}
    for k, p in enumerate(measurement.parameters):
        if estimate.prior_sd[k] == 0.0:
            continue
        unit = units.display(p.unit)
        parameters[p.name] = ParameterEstimate(
            value=units.number(estimate.theta[k], unit),
            sd=units.number(estimate.sd[k], unit),
            unit=unit,
            nominal=units.number(p.mean, unit),
            prior_sd=units.number(estimate.prior_sd[k], unit),
            identified=_how_well(float(estimate.shrinkage[k])),
            truth=None if truth is None else units.number(truth[k], unit),
        )
    return parameters


def _covariance(measurement: Measurement, estimate: Estimate) -> list[list[float]]:
    """Covariance of the parameters that are not fixed, in their display units."""
    free = np.flatnonzero(estimate.prior_sd > 0.0)
    names = [units.display(measurement.parameters[k].unit) for k in free]
    factor = np.array([units.factor(name) for name in names])
    covariance = estimate.covariance[np.ix_(free, free)] / np.outer(factor, factor)
    return [[float(value) for value in row] for row in covariance]


def _how_well(shrinkage: float) -> str:
    """How much the readings narrow a tolerance; `shrinkage` is posterior over prior."""
    if shrinkage <= Estimate.WEAK:
        return "seen"
    return "weak" if shrinkage <= Estimate.AT_PRIOR else "prior"


def _rms_by_channel(values: Array, names: np.ndarray) -> dict[str, float]:
    return {
        n: float(np.sqrt(np.mean(values[names == n] ** 2)))
        for n in dict.fromkeys(names)
    }


# -- combinations ----------------------------------------------------------------------


def combination_estimates(
    measurement: Measurement, estimate: Estimate, verdict: Identifiability
) -> list[CombinationEstimate]:
    """Each combination's departure from nominal, in the unit of its pivot."""
    places = [measurement.names.index(name) for name in verdict.names]
    departure = (estimate.theta - measurement.nominal)[places]
    covariance = estimate.covariance[np.ix_(places, places)]
    prior_root = measurement.prior_root(estimate.prior_sd > 0.0)[places]
    terms = verdict.coefficients_by_name(verdict.combinations)
    records = []
    for named, row in zip(terms, verdict.combinations, strict=True):
        pivot = int(np.flatnonzero(np.abs(row - 1.0) < 1e-9)[0])
        unit = units.display(measurement.parameters[places[pivot]].unit)
        records.append(
            CombinationEstimate(
                terms=named,
                value=units.number(float(row @ departure), unit),
                sd=units.number(float(np.sqrt(row @ covariance @ row)), unit),
                tolerance=units.number(float(np.linalg.norm(row @ prior_root)), unit),
                unit=unit,
            )
        )
    return records
