"""Closure: how far the gap shrinks on held-out readings with the selected effects.

With H the slopes of the parameters (prior N(0, I)), G the effects' columns (prior N(0,
S)) and Sigma the noise, readings are r ~ N(0, Sigma + H H^T) without the effects and
N(0, Sigma + H H^T + G S G^T) with them. Both predict the held-out readings from the
training ones by Gaussian conditioning: parameters, coefficients and what the noise
carries along a run are all learned from training readings alone. With e0, e1 the errors
of the two in n held-out readings,

    S0 = e0^T P^-1 e0 / n,    S1 = e1^T P^-1 e1 / n,    C = (S0 - S1) / (S0 - Snoise).

Both are whitened by the same P, the full predictive covariance without the effects. The
geometry that the training readings do not determine is in it, so that it does not hide
the effect: a whole held-out circle is off by many times the noise with no effect at
all. Snoise, the expectation of S0 without a gap, is then exactly 1 where the noise law
is right; whoever knows the effect reaches S1 = 1 in expectation, so that C = 1 is the
maximum.

The gain n (S0 - S1) has a standard deviation of about twice its own root; S0 - Snoise
has the chi-square's sqrt(2 / n) on top. A small gap in many readings therefore has a C
with a wide interval, and S0 <= Snoise leaves none to close: C is NaN. The ratio of two
closures on the same readings, as of the oracle's, is the ratio of the gains (S0 - S1),
without that uncertainty.
"""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from scipy import linalg, sparse, spatial
from scipy.sparse import csgraph

from oed.base import Array, Index
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy
from oed.noise import NoiseLaw, SharedFactor
from oed.result import ClosureRecord

# Folds of held-out readings: parts of every path, or whole runs.
#
# Runs that repeat one another, whichever way and however often, are held out together.

N_FOLDS = 5  #: number of folds
#: share of a run's poses that another must have for the two to repeat each other
REPEAT_SHARE = 0.8
#: runs from which on the bootstrap draws whole runs; below, stretches of runs
MIN_RUNS = 8
STILL_SHARE = 1e-3  #: share of the joints' extent below which a step is none


class Paths:
    """Which runs repeat one another, and how far along its path each reading is."""

    def __init__(self, problem: GapProblem) -> None:
        joints = [state.joints for state in problem.states]
        self._joints = discrepancy.values_of_poses(problem, joints)[:, 0]
        self._runs = problem.members
        self._run = problem.structure.run[problem.structure.chain]
        readings = problem.rows.groupby(["setup", "run", "order"], sort=False)
        self._reading = readings.ngroup().to_numpy()
        self._setup = problem.rows["setup"].to_numpy()
        self._size = len(problem)

    def within(self) -> tuple[Index, Index]:
        """Fold (N,), a fifth of each path, and unit (N,), a fold of one run."""
        fold = np.empty(self._size, dtype=np.intp)
        for number, runs in enumerate(self.groups()):
            rows = self._rows(runs)
            longest = max((self._runs[k] for k in runs), key=len)
            pose, count = self._run_places(rows, longest)
            is_short = count < N_FOLDS
            fold[rows] = (
                (pose + number) % N_FOLDS if is_short else pose * N_FOLDS // count
            )
        fold = np.unique(fold, return_inverse=True)[1]
        return fold, self._units(fold)

    def whole(self) -> tuple[Index, Index]:
        """As `within`, a fold's runs held out together; units: runs or fifths."""
        groups = self.groups()
        if len(groups) == 1:
            groups = [[k] for k in range(len(self._runs))]
        fold = np.empty(self._size, dtype=np.intp)
        load = np.zeros(min(N_FOLDS, len(groups)))
        for rows in sorted(map(self._rows, groups), key=len, reverse=True):
            least = np.argmin(load)
            fold[rows] = least
            load[least] += len(rows)
        part = np.zeros(self._size, dtype=np.intp)
        if len(self._runs) < MIN_RUNS:
            part = self.within()[0]
        return fold, self._units(part)

    def groups(self) -> list[list[int]]:
        """Numbers of runs on one path in one set-up, whichever way or passes."""
        count = len(self._runs)
        near = sparse.lil_matrix((count, count))
        setups = [self._setup[members[0]] for members in self._runs]
        for setup in dict.fromkeys(self._setup):
            self._link([k for k in range(count) if setups[k] == setup], near)
        groups, label = csgraph.connected_components(near, directed=False)
        return [np.flatnonzero(label == k).tolist() for k in range(groups)]

    def _rows(self, runs: Sequence[int]) -> Index:
        return np.concatenate([self._runs[k] for k in runs])

    def _link(self, runs: list[int], near: sparse.lil_matrix) -> None:
        """Mark pairs of runs of which one has nearly all its poses in the other."""
        points = [np.unique(self._joints[self._runs[k]], axis=0) for k in runs]
        count = len(runs)
        owner = np.repeat(np.arange(count), [len(p) for p in points])
        together = np.vstack(points)
        tolerance = self._tolerance(runs, together)
        tree = spatial.cKDTree(together)
        pairs = tree.query_pairs(tolerance, output_type="ndarray")
        pairs = np.vstack([pairs, pairs[:, ::-1]])
        neighbours = np.column_stack([pairs[:, 0], owner[pairs[:, 1]]])
        neighbours = np.unique(neighbours, axis=0)
        shared = np.zeros((count, count))
        np.add.at(shared, (owner[neighbours[:, 0]], neighbours[:, 1]), 1.0)
        poses = np.bincount(owner)[:, None]
        for a, b in np.argwhere(shared >= REPEAT_SHARE * poses):
            near[runs[a], runs[b]] = 1.0

    def _tolerance(self, runs: list[int], together: Array) -> float:
        """Distance in the joints below which two poses count as the same."""
        steps = []
        for k in runs:
            change = np.diff(self._joints[self._runs[k]], axis=0)
            steps.append(np.linalg.norm(change, axis=1))
        moved = np.concatenate(steps)
        extent = float(np.linalg.norm(np.ptp(together, axis=0)))
        moved = moved[moved > STILL_SHARE * extent]
        by_step = 0.25 * float(np.median(moved)) if moved.size else 0.0
        rounding = 1e-12 * float(np.abs(together).max())
        return max(by_step, STILL_SHARE * extent, rounding)

    def _run_places(self, rows: Index, longest: Index) -> tuple[Index, int]:
        """Place of each row among the longest run's poses, and their number."""
        _, first = np.unique(self._reading[longest], return_index=True)
        template = self._joints[longest[np.sort(first)]]
        _, nearest = spatial.cKDTree(template).query(self._joints[rows])
        used, pose = np.unique(nearest, return_inverse=True)
        return pose.astype(np.intp), len(used)

    def _units(self, part: Index) -> Index:
        """Number (N,) of each reading's pair of run and part (N,)."""
        pairs = np.column_stack([self._run, part])
        number = np.unique(pairs, axis=0, return_inverse=True)[1]
        return number.astype(np.intp).ravel()


Split = Literal["within", "whole"]
#: posterior precision (n, n) of coefficients, and its product (n,) with their mean
Information = tuple[Array, Array]


def closure(
    problem: GapProblem,
    law: NoiseLaw,
    columns: Array | Sequence[Array],
    rng: np.random.Generator,
    *,
    split: Split,
) -> ClosureRecord:
    """Closure by effects with given columns.

    columns    (N, k) in units of the stated noise per prior standard deviation; or
               several such, one for each value of the effects' constants (equally
               likely before), which the evidence of the training readings weighs fold
               by fold
    split      `within`: a fifth of the path of every run is held out in turn, the same
               fifth of all its repeats and of both directions. `whole`: whole runs,
               those that repeat one another together, in up to five folds. Where all
               runs repeat one another each is held out by itself; with one run nothing
               can be: NaN, n = 0

    The interval holds 95 % of a bootstrap over runs (stretches of them where they are
    few) of the ratio. A draw without a gap counts as +-inf by the sign of its gain;
    p_worse is the share of draws with a negative gain. The noise law is taken as known,
    its level too, and the folds do not depend on `rng`.
    """
    several = [columns] if isinstance(columns, np.ndarray) else list(columns)
    models = [np.hstack([problem.slopes, model]) for model in several]
    factor = law.factor(problem.structure)
    n = problem.slopes.shape[1]
    standard = factor.errors.standardise(problem.residual[:, None])
    scored, informations = [], []
    for model in models:
        slopes = factor.errors.standardise(model)
        values = factor.scored(np.hstack([slopes, standard]))
        product = slopes.T @ values
        scored.append(values)
        informations.append((product[:, :-1] + np.eye(len(product)), product[:, -1]))

    def predict(rows: Index) -> tuple[Array, Array]:
        errors, log_evidences, parts = [], [], []
        held_out = factor.hold_out(rows)
        for values, information in zip(scored, informations, strict=True):
            white = held_out.innovations(values)
            mean, log_evidence = learn(information, white)
            errors.append(white[:, -1] - white[:, :-1] @ mean)
            log_evidences.append(log_evidence)
            parts.append(white)
        weight = np.array(log_evidences)
        weight = np.exp(weight - weight.max())
        after = np.einsum("g,gn->n", weight / weight.sum(), np.array(errors))
        return standardise(informations[0], n, parts[0], after)

    return _score(problem, split, predict, rng)


def not_scored(split: Split) -> ClosureRecord:
    """Where nothing is closed, or no reading can be held out: no figure is known."""
    nan = float("nan")
    return ClosureRecord(split, nan, -np.inf, np.inf, nan, nan, nan, 1.0, 0)


def _score(
    problem: GapProblem,
    split: Split,
    predict: Callable[[Index], tuple[Array, Array]],
    rng: np.random.Generator,
) -> ClosureRecord:
    """Closure over all folds, of residuals without and with effects by `predict`."""
    paths = Paths(problem)
    fold, unit = paths.within() if split == "within" else paths.whole()
    before, after = np.zeros(len(problem)), np.zeros(len(problem))
    held_out = [np.flatnonzero(fold == k) for k in range(int(fold.max()) + 1)]
    if len(held_out) < 2:
        return not_scored(split)
    for rows in held_out:
        before[rows], after[rows] = predict(rows)
    gain = np.bincount(unit, before**2 - after**2)
    gap = np.bincount(unit, before**2 - 1.0)
    equal = np.full(len(gain), 1.0 / len(gain))
    drawn = rng.multinomial(len(gain), equal, size=2000).astype(float)
    gains, gaps = drawn @ gain, drawn @ gap
    infinite = np.where(gains == 0.0, 0.0, np.copysign(np.inf, gains))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(gaps > 0.0, gains / gaps, infinite)
    low, high = np.quantile(ratios, [0.025, 0.975], method="closest_observation")
    value = float("nan")
    if gap.sum() > 0.0:
        value = float(gain.sum() / gap.sum())
    return ClosureRecord(
        split=split,
        value=value,
        low=float(low),
        high=float(high),
        p_worse=float(np.mean(gains < 0.0)),
        s0=float(np.mean(before**2)),
        s1=float(np.mean(after**2)),
        s_noise=1.0,
        n=len(problem),
    )


# -- prediction of held-out readings ---------------------------------------------------
def learn(information: Information, white: Array) -> tuple[Array, float]:
    """Mean (n,) of the coefficients from the training readings, and log evidence.

    The log evidence is up to a constant.

    information    of all readings
    white          (m, n + 1) innovations of the held-out slopes and residuals, whose
                   information is taken off
    """
    precision, product = information
    slopes, residual = white[:, :-1], white[:, -1]
    root = linalg.cholesky(precision - slopes.T @ slopes, lower=True)
    product = product - slopes.T @ residual
    mean = linalg.cho_solve((root, True), product)
    log_det = float(np.log(np.diag(root)).sum())
    return np.asarray(mean), 0.5 * float(product @ mean) - log_det


def standardise(
    information: Information, n: int, white: Array, after: Array
) -> tuple[Array, Array]:
    """Held-out residuals (m,) without and with the effects, standardised.

    Both are whitened by the predictive covariance without the effects.

    information    of all readings; the first n coefficients are the parameters
    n              number of parameters
    white          (m, .) innovations: the parameters' slopes first, residuals last
    after          (m,) residuals with the effects
    """
    alone = np.column_stack([white[:, :n], white[:, -1]])
    precision, product = information[0][:n, :n], information[1][:n]
    mean, _ = learn((precision, product), alone)
    slopes = alone[:, :-1]
    root = linalg.cholesky(precision - slopes.T @ slopes, lower=True)
    half = linalg.solve_triangular(root, slopes.T, lower=True)
    spread = SharedFactor(half.T, np.zeros(1, dtype=np.intp))
    before = alone[:, -1] - slopes @ mean
    white_residuals = spread.whiten(np.column_stack([before, after]))
    return white_residuals[:, 0], white_residuals[:, 1]
