"""Identification and posterior, as sections of the result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed import identify, posterior, result, units
from oed.arrays import Array
from oed.measurement import Measurement, Series

#: draws shown in the corner plot
CORNER_DRAWS = 1500


def estimate_section(
    measurement: Measurement,
    series: Sequence[Series],
    estimate: identify.Estimate,
    truth: Array | None,
) -> result.EstimateSection:
    """Identified parameters in display units, residuals in the fine unit of the
    readings.
    """
    channels = [
        c
        for s in series
        for _ in range(len(s))
        for c in measurement.setups[s.setup].instrument.channels
    ]
    factor = np.array([units.factor(units.FINE[c.unit]) for c in channels])
    after, before = estimate.residuals / factor, estimate.before / factor
    labels = np.array([c.name for c in channels])
    return result.EstimateSection(
        parameters=_values(measurement, estimate, truth),
        rms_before={n: _rms(before[labels == n]) for n in dict.fromkeys(labels)},
        rms_after={n: _rms(after[labels == n]) for n in dict.fromkeys(labels)},
        units={c.name: units.FINE[c.unit] for c in channels},
        channels=[str(n) for n in labels],
        readings=len(after),
        dof=estimate.dof,
        chi2=estimate.chi2,
        iterations=[
            {
                "evaluations": r.iterations,
                "rms_before": r.rms_before,
                "rms_after": r.rms_after,
            }
            for r in estimate.rounds
        ],
        warnings=[*estimate.warnings, *_noise_words(estimate)],
        residuals=[float(v) for v in after],
        residuals_before=[float(v) for v in before],
    )


def _values(
    measurement: Measurement, estimate: identify.Estimate, truth: Array | None
) -> dict[str, result.ParameterEstimate]:
    found = {}
    for k, p in enumerate(measurement.parameters):
        if estimate.prior_sd[k] == 0.0:
            continue
        unit, share = units.display(p.unit), float(estimate.shrinkage[k])
        found[p.name] = result.ParameterEstimate(
            value=units.number(estimate.theta[k], unit),
            sd=units.number(estimate.sd[k], unit),
            unit=unit,
            nominal=units.number(p.nominal, unit),
            prior_sd=units.number(estimate.prior_sd[k], unit),
            identified=(
                "seen"
                if share <= identify.WEAK
                else "weak"
                if share <= identify.AT_PRIOR
                else "prior"
            ),
            truth=None if truth is None else units.number(truth[k], unit),
        )
    return found


def _noise_words(estimate: identify.Estimate) -> list[str]:
    scaled = [f"{n} {s:.2f}" for n, s in estimate.noise_scale.items() if s != 1.0]
    return (
        [f"the stated noise was scaled by what the residuals show: {', '.join(scaled)}"]
        if scaled
        else []
    )


def posterior_section(
    measurement: Measurement,
    estimate: identify.Estimate,
    drawn: posterior.Posterior,
    corner: int,
) -> result.PosteriorSection:
    """Marginals in display units, and draws along the worst-seen directions."""
    marginals = {}
    for k, p in enumerate(measurement.parameters):
        if estimate.prior_sd[k] == 0.0:
            continue
        unit = units.display(p.unit)
        values = units.from_si(drawn.flat[:, k], unit)
        low, high = np.quantile(values, [0.025, 0.975])
        marginals[p.name] = result.Marginal(
            mean=float(values.mean()),
            sd=float(values.std(ddof=1)),
            q025=float(low),
            q975=float(high),
            rhat=float(drawn.rhat[k]),
            ess=float(drawn.ess[k]),
            unit=unit,
        )
    directions, table = _worst(measurement, estimate, drawn, corner)
    return result.PosteriorSection(
        marginals=marginals,
        acceptance=drawn.acceptance,
        draws=len(drawn.flat),
        walkers=drawn.draws.shape[0],
        autocorrelation=drawn.autocorrelation,
        directions=directions,
        corner=table,
    )


def _worst(
    measurement: Measurement,
    estimate: identify.Estimate,
    drawn: posterior.Posterior,
    count: int,
) -> tuple[list[str], list[list[float]]]:
    """Identifiable directions with the widest posterior, in prior standard deviations,
    named by what they move most.
    """
    z = drawn.z.reshape(-1, drawn.z.shape[2])
    worst = np.argsort(-z.std(axis=0))[:count]
    basis = estimate.coordinates.basis
    scale = np.where(estimate.prior_sd > 0, estimate.prior_sd, 1.0)
    names = []
    for k in worst:
        weight = basis[:, k] / scale
        order = np.argsort(-np.abs(weight))[:3]
        names.append(
            " ".join(f"{weight[j]:+.2f} {measurement.names[j]}" for j in order)
        )
    thin = max(1, len(z) // CORNER_DRAWS)
    return names, [[float(v) for v in row] for row in z[::thin][:CORNER_DRAWS, worst]]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
