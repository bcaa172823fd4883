"""Compares held-out readings with their predictive intervals: the section `held_out`.

A new mounting adds unknowns of its own, such as a probe's offset, which no earlier
reading can know. They alone are fitted to the held-out readings, within their
tolerances, in readings and draws alike: r = Q (y - f), and the interval is that of
Q (y* - f), with Q = 1 - J_s (J_s^T W J_s + Lambda_s^-1)^-1 J_s^T W.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed import units
from oed.arrays import Array, Index, Mask
from oed.instrument import Channel
from oed.measurement import Measurement, Series
from oed.posterior import Posterior
from oed.result import HeldOutSection

#: posterior draws used for predictive intervals
PREDICTIVE_DRAWS = 2000
#: ends of a 95 % interval
INTERVAL = (0.025, 0.975)


def held_out_sections(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    posterior: Posterior,
    rng: np.random.Generator,
) -> list[HeldOutSection]:
    """One section for each series and channel of the held-out readings y (N,), SI."""
    count = min(PREDICTIVE_DRAWS, len(posterior.pooled))
    draws = rng.choice(len(posterior.pooled), size=count, replace=False)
    sections, start = [], 0
    for s in series:
        channels = measurement.setups[s.setup].instrument.channels
        readings = y[start : start + len(s) * len(channels)]
        start += len(readings)
        predicted = measurement.readings([s], posterior.pooled[draws])
        factors = _noise_factors(measurement, posterior, s.setup, draws)
        noise = measurement.noise([s]).draw(rng, predicted.shape) * factors[:, None]
        centre = predicted.mean(axis=0)
        adjust = _setup_adjustment(measurement, s, posterior)
        ends = np.quantile((predicted + noise - centre) @ adjust.T, INTERVAL, axis=0)
        raw = readings - centre
        adjusted = adjust @ raw
        for k, channel in enumerate(channels):
            members = slice(k, None, len(channels))
            residual, (low, high) = adjusted[members], ends[:, members]
            sections.append(
                _section(s.setup, channel, residual, raw[members], low, high)
            )
    return sections


def _section(
    setup: str,
    channel: Channel,
    residual: Array,
    raw: Array,
    low: Array,
    high: Array,
) -> HeldOutSection:
    unit = units.FINE[channel.unit]
    inside = (residual >= low) & (residual <= high)
    half_widths = (high - low) / 2.0
    return HeldOutSection(
        name=setup,
        channel=channel.name,
        n=len(residual),
        rms=units.number(float(np.sqrt(np.mean(residual**2))), unit),
        rms_raw=units.number(float(np.sqrt(np.mean(raw**2))), unit),
        unit=unit,
        coverage=float(inside.mean()),
        residuals=[units.number(v, unit) for v in residual],
        half_widths=[units.number(v, unit) for v in half_widths],
    )


def _setup_adjustment(
    measurement: Measurement, series: Series, posterior: Posterior
) -> Array:
    """Q (N, N), which takes the set-up's unknowns out of its readings."""
    mean = posterior.pooled.mean(axis=0)
    columns = _setup_unknowns(measurement, series.setup)
    slope = measurement.jacobian([series], mean)[:, columns]
    noise = measurement.noise([series])
    white = noise.whiten(slope)
    precision = white.T @ white + np.diag(measurement.tolerance[columns] ** -2.0)
    weight = white.T @ noise.whiten(np.eye(len(slope)))
    return np.asarray(np.eye(len(slope)) - slope @ np.linalg.solve(precision, weight))


def _setup_unknowns(measurement: Measurement, setup: str) -> Mask:
    """Free parameters (n,) of one set-up."""
    of_setup = np.array([n.startswith(f"{setup}.") for n in measurement.names])
    return of_setup & measurement.free


def _noise_factors(
    measurement: Measurement, posterior: Posterior, setup: str, draws: Index
) -> Array:
    """Noise factor of a set-up in each draw: that of a fitted set-up's instrument."""
    if not posterior.noise_groups:
        return np.ones(len(draws))
    instrument = measurement.setups[setup].instrument.name
    log_noise = posterior.log_noise.reshape(-1, posterior.log_noise.shape[2])[draws]
    for k, group in enumerate(posterior.noise_groups):
        if measurement.setups[group].instrument.name == instrument:
            return np.asarray(np.exp(log_noise[:, k]))
    return np.ones(len(draws))
