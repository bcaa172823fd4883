"""Runs that were driven the other way than their rows say, as far as readings can tell.

Play and friction follow the sense of travel, which the order of a run's rows states.
With U the columns of the effects and U' those of the same runs driven the other way, a
set of turned runs takes its rows from U'. Sets are compared by the log evidence of their
columns (`oed.corrected.forms`). All runs turned at once only change the sign of the
effects, so the smaller of two complementary sets is reported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.corrected.fit import CorrectedEstimate
from oed.corrected.forms import FormEvidence, form_evidence
from oed.gap import GapProblem

#: least gain of the log evidence
MIN_GAIN = 20.0
#: least change of a run's columns by turning it, in units of the noise
MIN_CHANGE = 1.0
#: fewest runs with a sense: of one run alone, turning only changes the effects' sign
MIN_RUNS = 2


@dataclasses.dataclass(frozen=True)
class TurnedRuns:
    """Runs whose rows are in the opposite order of their travel.

    runs    (set-up, run) of each
    before  residuals with the effects over the stated noise, of the readings as given
    after   the same with these runs turned
    gain    of the log evidence
    """

    runs: tuple[tuple[str, str], ...]
    before: float
    after: float
    gain: float


def find_turned_runs(corrected: CorrectedEstimate) -> TurnedRuns | None:
    """Runs that fit clearly better driven the other way; None where there are none."""
    readings, theta = corrected.readings, corrected.estimate.theta
    theta = theta[: corrected.parameters]
    as_stated = readings.problem(theta)
    other_way = as_stated.with_reversed_runs()
    search = _Search(
        form_evidence(as_stated),
        as_stated.residual,
        _columns(as_stated, corrected),
        _columns(other_way, corrected),
    )
    felt = [rows for rows in as_stated.members if search.is_felt(rows)]
    if len(felt) < MIN_RUNS:
        return None
    turned = search.best(felt)
    if turned.sum() > len(felt) / 2:
        turned = ~turned
    none = np.zeros(len(felt), dtype=bool)
    gain = search.value(felt, turned) - search.value(felt, none)
    if not turned.any() or gain < MIN_GAIN:
        return None
    names = [(as_stated.rows["setup"], as_stated.rows["run"], rows[0]) for rows in felt]
    labels = [(str(s.iloc[k]), str(r.iloc[k])) for s, r, k in names]
    return TurnedRuns(
        runs=tuple(
            label for label, is_one in zip(labels, turned, strict=True) if is_one
        ),
        before=search.ratio(felt, none),
        after=search.ratio(felt, turned),
        gain=gain,
    )


@dataclasses.dataclass(frozen=True)
class _Search:
    """Residual (N,) and columns (N, k) of the runs as given and turned, noise units."""

    evidence: FormEvidence
    residual: Array
    as_stated: Array
    turned: Array

    def is_felt(self, rows: Index) -> bool:
        """Whether turning the run of these readings changes them."""
        change = self.turned[rows] - self.as_stated[rows]
        return bool(np.linalg.norm(change) > MIN_CHANGE)

    def value(self, runs: Sequence[Index], turned: Mask) -> float:
        """Log evidence with some of the runs turned."""
        return self.evidence.log_evidence(self._columns(runs, turned), self.residual)

    def ratio(self, runs: Sequence[Index], turned: Mask) -> float:
        """Residuals over the stated noise with some of the runs turned."""
        columns = self._columns(runs, turned)
        unexplained = self.evidence.unexplained(columns, self.residual)
        return float(np.sqrt(unexplained / len(self.residual)))

    def _columns(self, runs: Sequence[Index], turned: Mask) -> Array:
        columns = self.as_stated.copy()
        for rows, is_turned in zip(runs, turned, strict=True):
            if is_turned:
                columns[rows] = self.turned[rows]
        return columns

    def best(self, runs: Sequence[Index]) -> Mask:
        """The set (R,) of turned runs of highest evidence: by single runs, two starts."""
        none = np.zeros(len(runs), dtype=bool)
        starts = [none, self._one_after_the_other(runs)]
        climbed = [self._climb(runs, start) for start in starts]
        return max(climbed, key=lambda turned: self.value(runs, turned))

    def _one_after_the_other(self, runs: Sequence[Index]) -> Mask:
        """Each run turned or not as the runs before it ask for."""
        turned = np.zeros(len(runs), dtype=bool)
        for k in range(1, len(runs)):
            rows = np.concatenate(runs[: k + 1])
            values = []
            for choice in (False, True):
                turned[k] = choice
                columns = np.zeros_like(self.as_stated)
                columns[rows] = self._columns(runs, turned)[rows]
                values.append(self.evidence.log_evidence(columns, self.residual))
            turned[k] = values[1] > values[0]
        return turned

    def _climb(self, runs: Sequence[Index], turned: Mask) -> Mask:
        """Turn the run that gains most, until none does."""
        value = self.value(runs, turned)
        while True:
            changed = [turned ^ (np.arange(len(runs)) == k) for k in range(len(runs))]
            values = [self.value(runs, one) for one in changed]
            k = int(np.argmax(values))
            if values[k] <= value + 1e-9:
                return turned
            turned, value = changed[k], values[k]


def _columns(problem: GapProblem, corrected: CorrectedEstimate) -> Array:
    """Columns (N, k) of the effects at their estimated sizes, in noise units."""
    parts = []
    for form in corrected.forms:
        signature = problem.signature(form.effect, form.constants)
        columns = signature.columns_of(form.signature.names)
        parts.append(problem.in_noise_units(columns))
    sizes = corrected.measurement.tolerance[corrected.parameters :]
    return np.hstack(parts) * sizes
