"""Reports parameters and effects estimated together: the section `corrected`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import msgspec
import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.checks.goodness import Goodness
from oed.compensate.command_grid import GridAxis
from oed.compensate.effects import (
    CorrectedAccuracy,
    CorrectedEstimate,
)
from oed.measurement.measurement import Measurement
from oed.posterior.posterior import Posterior
from oed.result import (
    CorrectedSection,
    EffectEstimate,
    GapSection,
    Marginal,
    PredictionSection,
    SpreadRecord,
)
from pkm_studies.stages.corrected.coefficients import coefficient_records
from pkm_studies.stages.corrected.conditions import conditions
from pkm_studies.stages.corrected.tables import effect_tables
from pkm_studies.stages.fit.estimate import estimate_section
from pkm_studies.stages.fit.posterior import marginal
from pkm_studies.stages.predict.accuracy import (
    accuracy_section,
    spread_record,
    with_wanted,
)
from pkm_studies.stages.predict.budget import budget_section


def corrected_section(
    corrected: CorrectedEstimate,
    truth: Array | None,
    origin: str,
    gap: GapSection | None,
    accuracy: CorrectedAccuracy | None,
    draws: Posterior | None,
    command: Array,
    axes: tuple[GridAxis, ...],
    wanted: Mapping[str, float],
    goodness: Goodness,
    *,
    noise_is_a_guess: bool,
) -> CorrectedSection:
    """The section of an estimate, with tables of its effects over a box of commands.

    `command` (n, n_dof) are those of the workspace, `truth` (n,) are a virtual machine's
    parameters, `wanted` the errors to reach, SI; `goodness` is of the fit.
    """
    measurement, estimate = corrected.measurement, corrected.estimate
    count = corrected.parameters
    if truth is not None:
        truth = np.concatenate([truth, np.full(len(corrected.scales), np.nan)])
    whole = estimate_section(measurement, corrected.series, estimate, truth)
    names = measurement.names[:count]
    parameters = {n: p for n, p in whole.parameters.items() if n in names}
    size = len(parameters)
    predicted = None
    if accuracy is not None:
        predicted = with_wanted(_predicted(measurement, accuracy), wanted)
    tables, not_tabled = effect_tables(corrected, command, axes, predicted)
    marginals = {} if draws is None else dict(_marginals(corrected, draws))
    return CorrectedSection(
        parameters=parameters,
        effects=dict(_coefficients(corrected)),
        constants={f.effect.name: dict(f.constants) for f in corrected.forms},
        conditions=conditions(corrected, gap),
        origin=origin,
        rms_after=whole.rms_after,
        units=whole.units,
        readings=whole.readings,
        chi2=estimate.chi2,
        dof=estimate.dof,
        covariance=[row[:size] for row in whole.covariance[:size]],
        prediction=predicted,
        parameters_only=_parameters_only(corrected, accuracy) if accuracy else {},
        posterior=marginals,
        tables=tables,
        not_tabled=dict(not_tabled),
        warnings=_warnings(goodness, noise_is_a_guess=noise_is_a_guess),
    )


def _predicted(
    measurement: Measurement, accuracy: CorrectedAccuracy
) -> PredictionSection:
    """The predicted accuracy with its budget."""
    compensated, budget = accuracy.compensated, accuracy.budget
    section = accuracy_section(measurement.kinematics, compensated, "corrected", budget)
    lines = budget_section(measurement.machine, compensated, budget)
    return msgspec.structs.replace(section, budget=lines)


def _warnings(goodness: Goodness, *, noise_is_a_guess: bool) -> list[str]:
    """Why the corrected values should not go into a controller; none if they fit."""
    if not goodness.is_bad(noise_is_a_guess=noise_is_a_guess):
        return []
    misfit = "no machine within its tolerances gives these readings"
    if goodness.ratio is not None:
        misfit = f"the residuals are {goodness.ratio:.1f} times the stated noise"
    return [f"{misfit} even with the effects in the model"]


def _coefficients(
    corrected: CorrectedEstimate,
) -> Iterator[tuple[str, EffectEstimate]]:
    """Each coefficient in a unit that a person reads."""
    records = coefficient_records(corrected)
    names, scales = corrected.coefficient_names, corrected.scales
    for name, c, scale in zip(names, records, scales, strict=True):
        unit, factor = units.coefficient_unit(c.unit)
        yield (
            name,
            EffectEstimate(
                value=c.value / factor,
                sd=c.sd / factor,
                unit=unit,
                effect=c.effect,
                prior_sd=float(scale) / factor,
                shape=c.shape,
            ),
        )


def _marginals(
    corrected: CorrectedEstimate, draws: Posterior
) -> Iterator[tuple[str, Marginal]]:
    """Posterior of every parameter that is free, and of every coefficient."""
    coefficients, at = dict(_coefficients(corrected)), corrected.parameters
    for k, p in enumerate(corrected.measurement.parameters):
        if corrected.estimate.prior_sd[k] == 0.0:
            continue
        if k < at:
            unit = units.display(p.unit)
            values = units.from_si(draws.pooled[:, k], unit)
        else:
            coefficient = coefficients[p.name]
            unit = coefficient.unit
            values = draws.pooled[:, k] * coefficient.prior_sd
        yield p.name, marginal(values, draws, k, unit)


def _parameters_only(
    corrected: CorrectedEstimate, accuracy: CorrectedAccuracy
) -> dict[str, SpreadRecord]:
    components = corrected.measurement.machine.components
    return {
        c.name: spread_record(accuracy.parameters_only[c.name], units.FINE[c.unit])
        for c in components
    }
