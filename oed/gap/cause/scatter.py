"""Whether readings scatter beyond their instrument, and in which shape.

A data sheet states the scatter of single readings, and is right to a factor. Readings
taken again the same way do not share their noise, whatever acts on the machine: they
measure it and nothing else, those of a later run with all that runs do not share. What
exceeds both is noise that the data sheet excludes, or an effect of a form that no answer
has. With P the energy of what differs between such readings and R that of the rest, f and
n degrees of freedom, errors of variance t^2 that recur at each pose, in units of the
noise, have over none

    log BF(t) = -n/2 log(1 + t^2)
                - ((f + n)/2 + a) log[ (b + (P + R / (1 + t^2))/2) / (b + (P + R)/2) ],

the noise level integrated over its prior about the stated one, inverse gamma (a, b). It
is the lack-of-fit test of a regression, with the stated noise as a further reference.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import linalg, special

from oed.base import Array, Index
from oed.effect_model import UNKNOWN_SIZES
from oed.fit_limits import chi2_is_large
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data.diagnosis import AGAIN, ON_THE_SPOT, ExcessScatter
from oed.gap.data.evidence import LEVEL_RATE, LEVEL_SHAPE
from oed.gap.data.problem import GapProblem
from oed.noise import NoiseLaw
from oed.noise_law import KNOWN_TO
from oed.result import GapSection

#: share of an unknown alone that recurs at each pose and is not smooth: as likely
ROUGH_SHARE = 0.5
#: shares of the scatter of one run or leg that are tried
SCATTER_SHARES = np.linspace(0.1, 0.9, 9)
#: odds over even scatter from which a run or leg is named, one of all that are tried
MIN_ODDS = 20.0


#: share of the largest value of a column below which two values are the same
EQUALITY_TOLERANCE = 1e-9
#: poses that count, evenly over all of them: time and memory stay linear in the readings
MAX_POSES = 200
#: columns of the readings' rows that say how a pose was reached
CONDITIONS = ("direction", "feed", "payload")


@dataclasses.dataclass(frozen=True, slots=True)
class Energies:
    """Whitened energy of residuals, and its degrees of freedom."""

    #: of what differs between readings taken again
    pure: float
    pure_freedom: int
    #: of all else that the parameters do not explain
    rest: float
    rest_freedom: int

    @property
    def log_evidence(self) -> float:
        """Log evidence of errors that recur at each pose, over all sizes, over none."""
        inflation = 1.0 + UNKNOWN_SIZES.values**2
        power = 0.5 * (self.pure_freedom + self.rest_freedom) + LEVEL_SHAPE
        rough = LEVEL_RATE + 0.5 * (self.pure + self.rest / inflation)
        none = LEVEL_RATE + 0.5 * (self.pure + self.rest)
        values = -0.5 * self.rest_freedom * np.log(inflation)
        values -= power * np.log(rough / none)
        shown = np.array([float(self.rest_freedom)])
        prior = UNKNOWN_SIZES.log_visible_shares(shown)[0]
        return float(special.logsumexp(values + prior))

    @property
    def factor(self) -> float:
        """Scatter of the rest over that between readings taken again."""
        variance = self.rest / self.rest_freedom
        return float(np.sqrt(variance / (self.pure / self.pure_freedom)))


def energies(problem: GapProblem, law: NoiseLaw, again: "Replicates") -> Energies:
    """Energies of the residuals, whitened by a law."""
    pure, pure_freedom = again.energy(problem, law)
    factor = law.factor(problem.structure)
    white = factor.whiten(problem.residual[:, None])[:, 0]
    whole, freedom = energy_beyond(white, factor.whiten(problem.slopes))
    return Energies(
        pure, pure_freedom, max(whole - pure, 0.0), max(freedom - pure_freedom, 0)
    )


def with_roughness(
    searches: Sequence[Search], hypotheses: Sequence[Hypothesis]
) -> tuple[list[Hypothesis], float]:
    """Hypotheses of which an unknown alone may be rough as well, best first.

    Rough are errors that recur at each pose in no smooth form. The second result is the
    part of an unknown alone that they are.
    """
    nothing = next(h for h in hypotheses if not h.is_gap)
    problem = searches[nothing.law].given
    again = replicates(problem)
    base, rough = [], []
    for search in searches:
        none = next((h for h in search.run() if not h.is_gap), None)
        if none is None or search.given is not problem:
            continue
        parts = energies(search.problem, search.law, again)
        base.append(none.log_evidence)
        rough.append(none.log_evidence + parts.log_evidence)
    ratio = float(special.logsumexp(rough) - special.logsumexp(base))
    if problem.statement.is_assumed and not len(again.rows):
        ratio = -np.inf  # nothing measures the noise, and nothing states it
    recurring = nothing.log_evidence + ratio + float(np.log(ROUGH_SHARE))
    share = 0.0
    results = []
    for h in hypotheses:
        if h.unknown and not h.effects:
            total = float(np.logaddexp(h.log_evidence, recurring))
            share = float(np.exp(recurring - total))
            h = dataclasses.replace(h, log_evidence=total)
        results.append(h)
    results.sort(key=lambda h: -h.score)
    return results, share


def excess_scatter(problem: GapProblem, law: NoiseLaw) -> ExcessScatter | None:
    """Scatter of readings within their runs over the stated one; None where it is as stated.

    It holds single errors and those carried along a run, not what a run repeats to, of
    which data sheets say nothing. None where the stated noise is an assumption.
    """
    if problem.statement.is_assumed:
        return None
    factor = _run_scatter(problem, law)
    freedom = float(len(problem.residual) - problem.slopes.shape[1])
    chi2 = freedom * (factor / KNOWN_TO) ** 2
    if freedom <= 0.0 or not chi2_is_large(chi2, freedom):
        return None
    return ExcessScatter(factor, GapSection.DATA_SHEET, shape(problem, law))


def unstated_scatter(problem: GapProblem, law: NoiseLaw) -> float | None:
    """Scatter with all that no data sheet states over it; None where it is usual."""
    between_runs = law.level * float(np.hypot(law.law.level[0], law.law.seat[0]))
    factor = float(np.hypot(_run_scatter(problem, law), between_runs))
    is_usual = problem.statement.is_assumed or factor <= KNOWN_TO
    return None if is_usual else factor


def _run_scatter(problem: GapProblem, law: NoiseLaw) -> float:
    square = np.mean(np.square(law.law.scale[0, problem.channel]))
    return law.level * float(np.sqrt(square))


def rough_scatter(problem: GapProblem, law: NoiseLaw) -> ExcessScatter:
    """Scatter of readings over that between readings taken again, or over the stated."""
    again = replicates(problem)
    parts = energies(problem, problem.stated_law, again)
    if not parts.pure_freedom:
        factor = float(np.sqrt(parts.rest / max(parts.rest_freedom, 1)))
        return ExcessScatter(factor, GapSection.DATA_SHEET, shape(problem, law))
    against = ON_THE_SPOT if again.on_the_spot else AGAIN
    return ExcessScatter(parts.factor, against, shape(problem, law))


# -- readings taken again --------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class Replicates:
    """Readings that were taken more than once.

    on_the_spot whether all were taken again within their run
    """

    rows: Index  #: (k,) numbers of these readings
    cell: Index  #: (k,) number of the pose, conditions and channel that each belongs to
    on_the_spot: bool

    def energy(self, problem: GapProblem, law: NoiseLaw) -> tuple[float, int]:
        """Whitened energy of what differs between them, and its degrees of freedom."""
        if not len(self.rows):
            return 0.0, 0
        factor = law.factor(problem.structure, self.rows)
        same = np.zeros((len(problem), int(self.cell.max()) + 1))
        same[self.rows, self.cell] = 1.0
        columns = factor.whiten(np.hstack([same, problem.slopes]))
        white = factor.whiten(problem.residual[:, None])[:, 0]
        return energy_beyond(white, columns)


def energy_beyond(white: Array, columns: Array) -> tuple[float, int]:
    """Energy of white values (k,) outside columns (k, c), and its degrees of freedom."""
    directions, sizes, _ = linalg.svd(columns, full_matrices=False, check_finite=False)
    axes = directions[:, sizes > EQUALITY_TOLERANCE * sizes.max(initial=0.0)]
    outside = white - axes @ (axes.T @ white)
    return float(outside @ outside), len(white) - axes.shape[1]


def replicates(problem: GapProblem) -> Replicates:
    """Readings of one channel that share poses, senses of motion and conditions."""
    cell = pd.factorize(pd.Series(list(map(tuple, _keys(problem)))))[0]
    often = np.bincount(cell)[cell] > 1
    poses = np.unique(cell[often])
    chosen = np.linspace(0, len(poses) - 1, min(len(poses), MAX_POSES)).astype(np.intp)
    rows = np.flatnonzero(np.isin(cell, poses[chosen]))
    numbers = np.unique(cell[rows], return_inverse=True)[1].astype(np.intp)
    run = problem.structure.run[problem.structure.chain[rows]]
    runs_of = pd.Series(run).groupby(numbers).nunique()
    return Replicates(rows, numbers, bool((runs_of == 1).all()))


def _keys(problem: GapProblem) -> Array:
    """(N, c) whole numbers that are equal where two readings are taken the same way."""
    parts = []
    for number, (series, state) in enumerate(
        zip(problem.series, problem.states, strict=True)
    ):
        channels = len(problem.measurement.setups[series.setup].instrument.channels)
        poses = np.hstack([state.joints, state.motion_sign])
        read = poses[series.index].reshape(len(series.index), -1)
        rows = np.repeat(_numbers(read), channels)
        parts.append(np.column_stack([np.full(len(rows), number), rows]))
    keys = [np.vstack(parts), problem.channel]
    recorded = [name for name in CONDITIONS if name in problem.rows]
    conditions = problem.rows[recorded].fillna(0.0).to_numpy(dtype=float)
    return np.column_stack([*keys, _numbers(conditions)])


def _numbers(values: Array) -> Index:
    """Number (n,) of each distinct row of values (n, c), rounding apart."""
    unit = EQUALITY_TOLERANCE * np.maximum(
        np.abs(values).max(axis=0, initial=0.0), EQUALITY_TOLERANCE
    )
    whole = np.round(np.nan_to_num(values) / (10.0 * unit)).astype(np.int64)
    return np.unique(whole, axis=0, return_inverse=True)[1].ravel()


# -- shape -----------------------------------------------------------------------------
def shape(problem: GapProblem, law: NoiseLaw) -> str:
    """How the scatter is spread: in one run or leg, along runs, or in no way."""
    factor = law.factor(problem.structure)
    white = factor.whiten(problem.residual[:, None])[:, 0]
    slopes = factor.whiten(problem.slopes)
    axes = np.linalg.svd(slopes, full_matrices=False)[0]
    squares = np.empty(len(problem))
    squares[factor.order] = (white - axes @ (axes.T @ white)) ** 2
    weights = _weights(problem)
    gains = {name: _gain(squares, weight) for name, weight in weights.items()}
    best = max(gains, key=lambda name: gains[name], default="")
    if best and gains[best] > np.log(MIN_ODDS * len(gains)):
        return best
    return "along the run" if law.law.correlated[0] > 0.5 else "white"


def _weights(problem: GapProblem) -> dict[str, Array]:
    """Variance (N,) of the readings by an error of each leg, and of each run."""
    slopes = [
        np.abs(response.joints[0]).reshape(-1, response.joints[0].shape[-1])
        for response in problem.responses
    ]
    legs = problem.noise_units(np.vstack(slopes)) ** 2
    weights = {f"leg {k + 1}": legs[:, k] for k in range(legs.shape[1])}
    runs = problem.rows["run"].to_numpy()
    for run in np.unique(runs):
        weights[f"run {run}"] = (runs == run).astype(float)
    return weights


def _gain(squares: Array, weight: Array) -> float:
    """Log likelihood of squares (N,) with a part of their variance by weights (N,)."""
    mean = float(np.mean(weight))
    if not mean > 0.0:
        return 0.0
    variance = 1.0 - SCATTER_SHARES[:, None] + SCATTER_SHARES[:, None] * weight / mean
    level = np.mean(squares / variance, axis=1)
    even = np.log(np.mean(squares))
    gains = even - np.log(level) - np.mean(np.log(variance), axis=1)
    return 0.5 * len(squares) * float(gains.max())
