"""Compares held-out readings with their predictive intervals: the section `held_out`.

A new mounting adds unknowns of its own, such as a probe's offset, which no earlier
reading can know. They alone are fitted to the held-out readings, within their
tolerances, in readings and draws alike: r = Q (y - f), and the interval is that of
Q (y* - f), with Q = 1 - J_s (J_s^T W J_s + Lambda_s^-1)^-1 J_s^T W.

The verdict compares with readings drawn from the prediction itself, so that errors which
all readings share count as such. The share inside the 95 % intervals is too low where
fewer than `RARE` of the draws have a lower one. The ratio of the rms after the fit to
that before it contradicts the fit where few draws have a larger one, and confirms it
where few draws of the nominal numbers have a smaller one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed import units
from oed.base import Array, Mask
from oed.estimation import Estimate
from oed.instrument import Channel
from oed.measurement import Measurement, Series, reading_structure
from oed.noise import Laws
from oed.result import HeldOutSection, HeldOutVerdict

#: ends of a 95 % interval
INTERVAL = (0.025, 0.975)
#: share of draws that are rarer than chance
RARE = 0.01
READ_AGAIN = (
    "Either they were read with other numbers in the machine than stated, such as a bed"
    " mesh probed before the last calibration was saved, or the fit is wrong: read them"
    " again before its numbers are used"
)


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
        rms=_rms_in(residual, unit),
        rms_raw=_rms_in(raw, unit),
        unit=unit,
        coverage=compared.coverage,
        residuals=[units.number(v, unit) for v in residual],
        half_widths=[units.number(v, unit) for v in half_widths],
        predicted=_rms_in(compared.draws, unit),
        rms_before=_rms_in(compared.before, unit),
        verdict=compared.verdict,
        words=compared.words(setup, channel.name, unit),
    )


def _rms_in(values: Array, unit: str) -> float:
    return units.number(_rms(values), unit)


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
    laws = Laws.stated(structure, len(drawn.law), drawn.estimate.scatter)
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
    errors = laws.whitening(structure).draw(
        rng, structure.statement, estimated=fitted is not None
    )
    return structure.restore(errors)


def _channel_kind(measurement: Measurement, name: str) -> tuple[str, str]:
    """Instrument and channel of a group of readings, `set-up.channel`."""
    setup, _, channel = name.rpartition(".")
    return measurement.setups[setup].instrument.name, channel


# -- verdict ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class HeldOutComparison:
    """Readings of one channel against a fit and against the nominal numbers, SI.

    residual  (n,) reading minus the centre of the prediction
    before    (n,) reading minus what the nominal numbers give
    low, high (n,) ends of the 95 % intervals of the residual
    draws     (m, n) predicted residuals
    noise     (m, n) their noise alone
    """

    residual: Array
    before: Array
    low: Array
    high: Array
    draws: Array
    noise: Array

    def take(self, members: slice) -> HeldOutComparison:
        """The comparison of some readings."""
        fields = (field.name for field in dataclasses.fields(self))
        return HeldOutComparison(
            **{name: getattr(self, name)[..., members] for name in fields}
        )

    @property
    def coverage(self) -> float:
        """Share of the readings inside their intervals."""
        return float(self._inside(self.residual))

    @property
    def is_uncovered(self) -> bool:
        """Whether fewer readings are inside than belong there."""
        return self.coverage < float(np.quantile(self._inside(self.draws), RARE))

    @property
    def verdict(self) -> HeldOutVerdict:
        """What the readings say of the fit."""
        correction = self.before - self.residual
        gain = _mean_square(self.before) - _mean_square(self.residual)
        by_fit = _mean_square(self.draws + correction) - _mean_square(self.draws)
        by_nominal = _mean_square(self.noise) - _mean_square(self.noise - correction)
        if gain < min(np.quantile(by_fit, RARE), 0.0):
            return "contradicts"
        if gain > max(np.quantile(by_nominal, 1.0 - RARE), 0.0):
            return "confirms"
        return "contradicts" if self.is_uncovered else "agrees"

    def words(self, setup: str, channel: str, unit: str) -> str:
        """The verdict in words."""
        predicted, after, before = (
            f"{units.number(value, unit):.3g} {unit}"
            for value in map(_rms, (self.draws, self.residual, self.before))
        )
        share = f"{100.0 * self.coverage:.0f} %"
        sentence = (
            f"Held-out readings of {setup} ({len(self.residual)}, {channel}): predicted"
            f" {predicted} rms, seen {after} rms ({before} with the nominal numbers);"
            f" {share} are inside the predicted 95 %"
        )
        return ". ".join([sentence, *self._conclusions()])

    def _conclusions(self) -> list[str]:
        verdict = self.verdict
        if verdict == "contradicts":
            why = "the nominal numbers predict them better"
            if self.is_uncovered:
                why = "fewer are inside than belong there"
            return [f"They contradict the fit: {why}", READ_AGAIN]
        lines = ["They confirm the fit"] if verdict == "confirms" else []
        if self.is_uncovered:
            lines.append(
                "Fewer are inside than belong there: they scatter more than the stated or"
                " estimated noise says"
            )
        return lines

    def _inside(self, residual: Array) -> Array:
        inside = (residual >= self.low) & (residual <= self.high)
        return np.asarray(inside.mean(axis=-1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _mean_square(values: Array) -> Array:
    """Mean square over the last axis."""
    return np.asarray(np.mean(values**2, axis=-1))
