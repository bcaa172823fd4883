"""What held-out readings say of a fit: whether they confirm it, agree or contradict it.

Both judgements compare with readings drawn from the prediction itself, so that errors
which all readings share count as such. The share inside the 95 % intervals is too low
where fewer than `RARE` of the draws have a lower one. The ratio of the rms after the fit
to that before it contradicts the fit where few draws have a larger one, and confirms it
where few draws of the nominal numbers have a smaller one.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.result import HeldOutVerdict

#: share of draws that are rarer than chance
RARE = 0.01
READ_AGAIN = (
    "Either they were read with other numbers in the machine than stated, such as a bed"
    " mesh probed before the last calibration was saved, or the fit is wrong: read them"
    " again before its numbers are used"
)


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
