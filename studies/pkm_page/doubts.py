"""What speaks against a reading before it is taken: its range, its neighbours, all others."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from oed import checks
from oed.base import Array
from oed.checks import CheckFinding
from oed.dataset import written
from oed.fit_limits import GUESS_RATIO
from oed.measurement import Measurement, Series
from pkm_page import typed
from pkm_studies.base import Stream
from pkm_studies.sessions import Adviser, FittedReadings

#: half width of an interval in standard deviations: one good reading in ten thousand
#: lies outside, as `oed.checks.session.RANGE_FALSE_ALARM` says
RANGE_DEVIATIONS: Final = 3.89
#: degrees of freedom from which on the residuals say how large the noise is
MIN_DOF: Final = 5


@dataclasses.dataclass(frozen=True)
class ReadingInterval:
    """Where the channels (k,) of the next reading should lie, SI."""

    middle: Array
    half: Array

    def outside(self, y: Array) -> list[int]:
        """Channels, by number, of values (k,) that lie outside."""
        return [int(k) for k in np.flatnonzero(np.abs(y - self.middle) > self.half)]


def interval(
    adviser: Adviser, fitted: FittedReadings | None, series: Series
) -> ReadingInterval:
    """The interval of one reading, from the tolerances or from the readings so far."""
    one = [series]
    if fitted is None:
        measurement = adviser.base.measurement
        nothing = np.zeros(len(measurement.sigma(one)))
        session = checks.session_readings(measurement, one, nothing)
        ranges = session.predict_ranges(adviser.base.rng(Stream.CHECKS))
        return ReadingInterval(ranges.middle, ranges.factor * ranges.sd)
    measurement, estimate = fitted.state.measurement, fitted.estimate
    slopes = measurement.jacobian(one, estimate.theta)
    variance = np.einsum("ij,jk,ik->i", slopes, estimate.covariance, slopes)
    noise = measurement.sigma(one) * _noise_factor(fitted)
    half = RANGE_DEVIATIONS * np.sqrt(np.maximum(variance, 0.0) + noise**2)
    return ReadingInterval(measurement.readings(one, estimate.theta), half)


def _noise_factor(fitted: FittedReadings) -> float:
    """How much larger than stated the noise may be."""
    if fitted.state.noise_is_a_guess:
        return float(GUESS_RATIO)
    estimate = fitted.estimate
    if estimate.dof < MIN_DOF:
        return 1.0
    return float(np.sqrt(max(estimate.chi2 / estimate.dof, 1.0)))


def value_doubts(
    measurement: Measurement,
    setup: str,
    expected: ReadingInterval,
    y: Array,
    entries: Sequence[str],
) -> list[str]:
    """Sentences on values (k,) of channels that lie outside their interval."""
    channels = measurement.setups[setup].instrument.channels
    sentences = []
    for k in expected.outside(y):
        channel = channels[k]
        middle, half = float(expected.middle[k]), float(expected.half[k])
        low, unit = written(middle - half, channel.unit)
        high, _ = written(middle + half, channel.unit)
        phrase = f"{channel.name} should lie between {low:.7g} and {high:.7g} {unit}"
        if len(entries) == len(channels):
            slip = typed.slip(entries[k], low, high)
            phrase += f"; {slip}" if slip else ""
        sentences.append(phrase if phrase.endswith("?") else f"{phrase}.")
    return sentences


def session_doubts(
    before: FittedReadings | None, after: FittedReadings, row: int
) -> Iterator[str]:
    """What a check of all readings finds once a new one, in a row of the file, is in."""
    doubted_before = {(f.kind, f.rows) for f in _findings(before)}
    kinds = {f.kind for f in _findings(before)}
    for finding in _findings(after):
        if finding.is_remark:
            continue
        if row in finding.rows or (
            finding.kind not in kinds
            and (finding.kind, finding.rows) not in doubted_before
        ):
            yield finding.sentence


def _findings(fitted: FittedReadings | None) -> Sequence[CheckFinding]:
    checked = None if fitted is None else fitted.state.checked
    return () if checked is None else checked.findings
