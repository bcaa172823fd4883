"""Residual accuracy over the workspace, virtual machines that check it, and readings
kept out of the fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed import compensate, identify, information, predict, result, simulate, units
from oed.arrays import Array, Index
from oed.measurement import Measurement, Series
from oed.posterior import Posterior
from pkm_studies.progress import Progress
from pkm_studies.stages import describe

#: posterior draws used for predictive intervals
PREDICTIVE = 2000


def section(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    reference: predict.Reference,
    rng: np.random.Generator,
    estimate: identify.Estimate | None,
    realised: dict[str, predict.Spread] | None,
) -> result.PredictionSection:
    """Prediction from the plan (tolerances only), or with what was identified."""
    keep = len(measurement.machine.parameters)
    tolerance = measurement.tolerance
    at = measurement.nominal if estimate is None else estimate.theta
    noise = measurement.noise(series) if estimate is None else estimate.noise
    h = noise.whiten(measurement.jacobian(series, at)) * tolerance
    scale = np.outer(tolerance[:keep], tolerance[:keep])
    covariance = information.posterior_covariance(h)[:keep, :keep] * scale
    maps = predict.error_maps(measurement.kinematics, command, reference)
    foreseen = predict.predict(
        maps,
        np.diag(tolerance[:keep] ** 2),
        covariance,
        rng,
        mean=(
            None if estimate is None else (estimate.theta - measurement.nominal)[:keep]
        ),
        reference=reference,
        sources=predict.budget_sources(h, tolerance, measurement.names, keep),
    )
    return _told(
        measurement, foreseen, "plan" if estimate is None else "identified", realised
    )


def _told(
    measurement: Measurement,
    foreseen: predict.Prediction,
    mode: str,
    realised: dict[str, predict.Spread] | None,
) -> result.PredictionSection:
    components = {c.name: c for c in measurement.machine.components}
    fine = {n: units.FINE[c.unit] for n, c in components.items()}
    return result.PredictionSection(
        reference=foreseen.reference,
        components={
            n: result.ComponentAccuracy(
                compensatable=components[n].compensatable,
                before=_spread(foreseen.before[n], fine[n]),
                after=_spread(foreseen.after[n], fine[n]),
                known=_spread(foreseen.known[n], fine[n]),
                budget=foreseen.budget[n],
            )
            for n in foreseen.names
        },
        unit=fine,
        poses=len(foreseen.command),
        map=[
            result.MapPoint(
                describe.command(measurement.machine, c),
                {
                    n: units.number(foreseen.sd_before[i, k], fine[n])
                    for k, n in enumerate(foreseen.names)
                },
                {
                    n: units.number(foreseen.sd_after[i, k], fine[n])
                    for k, n in enumerate(foreseen.names)
                },
            )
            for i, c in enumerate(foreseen.command)
        ],
        mode=mode,
        realised=(
            None
            if realised is None
            else {n: _spread(s, fine[n]) for n, s in realised.items()}
        ),
    )


def virtual_machines(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    reference: predict.Reference,
    count: int,
    rng: np.random.Generator,
    stages: Sequence[Sequence[str]],
    progress: Progress,
) -> dict[str, predict.Spread] | None:
    """Machines drawn from the tolerances, read, identified, compensated, and looked at
    exactly.
    """
    if not count:
        return None
    kinematics, keep = measurement.kinematics, len(measurement.machine.parameters)
    home = measurement.machine.home_command[None]
    about = (
        compensate.error_model(kinematics, command),
        compensate.error_model(kinematics, home),
    )
    errors = []
    for k in range(count):
        truth = simulate.draw(measurement, rng)
        y = simulate.read(measurement, series, truth, rng)
        found = identify.identify(measurement, series, y, stages=stages)
        twists = []
        for at in (command, home):
            q = compensate.joints(kinematics, at, found.theta[:keep])
            twists.append(compensate.pose_error(kinematics, at, q, truth[:keep]))
        told = predict.referenced(
            twists[0], twists[1], *about, reference, measurement.machine.lever
        )
        errors.append(kinematics.components(command, told))
        progress.share((k + 1) / count)
    table = np.array(errors)
    return {
        c.name: predict.spread_of(table[:, :, k])
        for k, c in enumerate(measurement.machine.components)
    }


def held_out(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    drawn: Posterior,
    rng: np.random.Generator,
) -> list[result.HeldOutSection]:
    """Readings that the fit never saw, against their 95 % predictive intervals, set-up
    by set-up.

    A new mounting brings unknowns of its own (a probe's offset), which no earlier
    reading can know. They alone are adjusted to the readings kept out, within their
    tolerances, on both sides: r = Q (y - f), and the interval is that of Q (y* - f),
    with Q = 1 - J_s (J_s^T W J_s + Lambda_s^-1)^-1 J_s^T W. `rms_raw` is without that.
    """
    found, start = [], 0
    take = rng.choice(
        len(drawn.flat), size=min(PREDICTIVE, len(drawn.flat)), replace=False
    )
    scale = _NoiseFactors(measurement, drawn)
    for s in series:
        channels = measurement.setups[s.setup].instrument.channels
        read = y[start : start + len(s) * len(channels)]
        start += len(read)
        predicted = measurement.readings([s], drawn.flat[take])
        noise = (
            measurement.noise([s]).draw(rng, predicted.shape)
            * scale(s.setup, take)[:, None]
        )
        centre = predicted.mean(axis=0)
        adjust = _own_unknowns(measurement, s, drawn)
        low, high = np.quantile(
            (predicted + noise - centre) @ adjust.T, [0.025, 0.975], axis=0
        )
        after = adjust @ (read - centre)
        for k, channel in enumerate(channels):
            unit = units.FINE[channel.unit]
            mine = slice(k, None, len(channels))
            residual, raw = after[mine], (read - centre)[mine]
            inside = (residual >= low[mine]) & (residual <= high[mine])
            found.append(
                result.HeldOutSection(
                    name=s.setup,
                    channel=channel.name,
                    n=len(residual),
                    rms=units.number(float(np.sqrt(np.mean(residual**2))), unit),
                    rms_raw=units.number(float(np.sqrt(np.mean(raw**2))), unit),
                    unit=unit,
                    coverage=float(inside.mean()),
                    residuals=[units.number(v, unit) for v in residual],
                    half_widths=[
                        units.number(v, unit) for v in (high[mine] - low[mine]) / 2.0
                    ],
                )
            )
    return found


def _own_unknowns(measurement: Measurement, series: Series, drawn: Posterior) -> Array:
    """Q (N, N) that takes the set-up's own unknowns out of readings, weighed with their
    tolerances.
    """
    mean = drawn.flat.mean(axis=0)
    mine = (
        np.array([n.startswith(f"{series.setup}.") for n in measurement.names])
        & measurement.free
    )
    slope = measurement.jacobian([series], mean)[:, mine]
    noise = measurement.noise([series])
    white = noise.whiten(slope)
    precision = white.T @ white + np.diag(measurement.tolerance[mine] ** -2.0)
    weight = white.T @ noise.whiten(np.eye(len(slope)))
    return np.asarray(np.eye(len(slope)) - slope @ np.linalg.solve(precision, weight))


@dataclasses.dataclass(frozen=True)
class _NoiseFactors:
    """Noise factor of a set-up in each draw: its own, or that of a fitted set-up with
    the same instrument.
    """

    measurement: Measurement
    drawn: Posterior

    def __call__(self, setup: str, take: Index) -> Array:
        if not self.drawn.noise_groups:
            return np.ones(len(take))
        wanted = self.measurement.setups[setup].instrument.name
        log_noise = self.drawn.log_noise.reshape(-1, self.drawn.log_noise.shape[2])[
            take
        ]
        for k, group in enumerate(self.drawn.noise_groups):
            if self.measurement.setups[group].instrument.name == wanted:
                return np.asarray(np.exp(log_noise[:, k]))
        return np.ones(len(take))


def _spread(spread: predict.Spread, unit: str) -> result.SpreadRecord:
    return result.SpreadRecord(
        units.number(spread.rms, unit),
        units.number(spread.p95, unit),
        units.number(spread.largest, unit),
        unit,
    )
