"""Compares held-out readings with their predictive intervals: the section `held_out`.

A new mounting adds unknowns of its own, such as a probe's offset, which no earlier
reading can know. They alone are fitted to the held-out readings, within their
tolerances, in readings and draws alike: r = Q (y - f), and the interval is that of
Q (y* - f), with Q = 1 - J_s (J_s^T W J_s + Lambda_s^-1)^-1 J_s^T W.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Mask
from oed.estimation.estimate import Estimate
from oed.measurement.measurement import Measurement, Series
from oed.measurement.reading_structure import reading_structure
from oed.model.instrument import Channel
from oed.noise.process import Whitening, stated_laws
from oed.result import HeldOutSection
from pkm_studies.stages.predict.hold_out_verdict import HeldOutComparison

#: ends of a 95 % interval
INTERVAL = (0.025, 0.975)


@dataclasses.dataclass(frozen=True, eq=False)
class HypothesisDraws:
    """Draws of the machine by one fit.

    estimate  the fit
    theta     (m, n) parameters, SI
    law       (m, d) coordinates of the noise law
    changes   (m, N) of the held-out readings by effects, SI; None without
    """

    estimate: Estimate
    theta: Array
    law: Array
    changes: Array | None = None

    def readings(self, measurement: Measurement, series: Series, start: int) -> Array:
        """Readings (m, k) of a series, the held-out ones from `start` on, SI."""
        predicted = measurement.readings([series], self.theta)
        if self.changes is None:
            return predicted
        return predicted + self.changes[:, start : start + predicted.shape[1]]


def held_out_sections(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    drawn: Sequence[HypothesisDraws],
    rng: np.random.Generator,
) -> list[HeldOutSection]:
    """One section for each series and channel of the held-out readings y (N,), SI.

    drawn  by each hypothesis, as many as its share
    """
    mean = np.vstack([machines.theta for machines in drawn]).mean(axis=0)
    sections, start = [], 0
    for s in series:
        channels = measurement.setups[s.setup].instrument.channels
        readings = y[start : start + len(s) * len(channels)]
        predicted = np.vstack([m.readings(measurement, s, start) for m in drawn])
        start += len(readings)
        noise = np.vstack([_noise_draws(measurement, s, m, rng) for m in drawn])
        centre = predicted.mean(axis=0)
        adjust = _setup_adjustment(measurement, s, mean)
        draws = (predicted + noise - centre) @ adjust.T
        low, high = np.quantile(draws, INTERVAL, axis=0)
        raw = readings - centre
        before = readings - measurement.readings([s], measurement.nominal)
        whole = HeldOutComparison(
            residual=adjust @ raw,
            before=adjust @ before,
            low=low,
            high=high,
            draws=draws,
            noise=noise @ adjust.T,
        )
        for k, channel in enumerate(channels):
            members = slice(k, None, len(channels))
            sections.append(
                _section(s.setup, channel, whole.take(members), raw[members])
            )
    return sections


def _section(
    setup: str, channel: Channel, compared: HeldOutComparison, raw: Array
) -> HeldOutSection:
    unit = units.FINE[channel.unit]
    residual = compared.residual
    half_widths = (compared.high - compared.low) / 2.0
    return HeldOutSection(
        name=setup,
        channel=channel.name,
        n=len(residual),
        rms=_rms(residual, unit),
        rms_raw=_rms(raw, unit),
        unit=unit,
        coverage=compared.coverage,
        residuals=[units.number(v, unit) for v in residual],
        half_widths=[units.number(v, unit) for v in half_widths],
        predicted=_rms(compared.draws, unit),
        rms_before=_rms(compared.before, unit),
        verdict=compared.verdict,
        words=compared.words(setup, channel.name, unit),
    )


def _rms(values: Array, unit: str) -> float:
    return units.number(float(np.sqrt(np.mean(values**2))), unit)


def _setup_adjustment(measurement: Measurement, series: Series, mean: Array) -> Array:
    """Q (N, N), which takes the set-up's unknowns out of its readings."""
    columns = _setup_unknowns(measurement, series.setup)
    slope = measurement.jacobian([series], mean)[:, columns]
    noise = measurement.noise([series])
    white = noise.whiten(slope)
    precision = white.T @ white + np.diag(measurement.tolerance[columns] ** -2.0)
    weight = white.T @ noise.whiten(np.eye(len(slope)))
    return np.eye(len(slope)) - slope @ np.linalg.solve(precision, weight)


def _setup_unknowns(measurement: Measurement, setup: str) -> Mask:
    """Free parameters (n,) of one set-up."""
    of_setup = np.array([n.startswith(f"{setup}.") for n in measurement.names])
    return of_setup & measurement.free


def _noise_draws(
    measurement: Measurement,
    series: Series,
    drawn: HypothesisDraws,
    rng: np.random.Generator,
) -> Array:
    """Errors (m, N), SI, of new readings: one for each draw of the noise law."""
    structure = reading_structure(measurement, [series], drawn.theta[0])
    laws = stated_laws(structure, len(drawn.law), drawn.estimate.scatter)
    fitted = drawn.estimate.noise_posterior
    if fitted is not None:
        law = fitted.prior.laws(drawn.law)
        kinds = [_channel_kind(measurement, n) for n in fitted.structure.names]
        scale = np.ones((len(drawn.law), len(structure.names)))
        for k, name in enumerate(structure.names):
            kind = _channel_kind(measurement, name)
            if kind in kinds:
                scale[:, k] = law.scale[:, kinds.index(kind)]
        laws = dataclasses.replace(law, scale=scale)
    errors = Whitening(structure, laws).draw(
        rng, structure.statement, estimated=fitted is not None
    )
    return structure.restore(errors)


def _channel_kind(measurement: Measurement, name: str) -> tuple[str, str]:
    """Instrument and channel of a group of readings, `set-up.channel`."""
    setup, _, channel = name.rpartition(".")
    return measurement.setups[setup].instrument.name, channel
