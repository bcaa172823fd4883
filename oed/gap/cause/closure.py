"""How far the gap shrinks on held-out readings once the selected effects are added.

With H the slopes of the parameters (prior N(0, I)), G the effects' columns (prior N(0,
S)) and Sigma the noise, readings are r ~ N(0, Sigma + H H^T) without the effects and
N(0, Sigma + H H^T + G S G^T) with them. Both predict the held-out readings from the
training ones by Gaussian conditioning: parameters, coefficients and what the noise
carries along a run are all learned from training readings alone. With e0, e1 the errors
of the two in n held-out readings,

    S0 = e0^T P^-1 e0 / n,    S1 = e1^T P^-1 e1 / n,    C = (S0 - S1) / (S0 - Snoise).

Both are whitened by the same P, the full predictive covariance without the effects: the
geometry that the training readings never saw is in it, so it does not drown the effect
(a whole unseen circle is off by many times the noise with no effect at all); Snoise,
the expectation of S0 when nothing is wrong, is then exactly 1 where the noise law is
right; and whoever knows the effect reaches S1 = 1 in expectation, so C = 1 is the most
that can be had.

The gain n (S0 - S1) has a standard deviation of about twice its own root; S0 - Snoise
has the chi-square's sqrt(2 / n) on top. A small gap in many readings therefore has a C
with a wide interval, and S0 <= Snoise leaves none to close: C is NaN. C over another's
C on the same readings (the oracle's) is the ratio of the gains (S0 - S1), free of that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from scipy import linalg, sparse, spatial
from scipy.sparse import csgraph

from oed.arrays import Array, Index
from oed.gap.data.diagnosis import Closure
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw

Split = Literal["within", "whole"]
FOLDS = 5
#: joints closer than this share of a run's step count as the same pose; two runs repeat
#: each other where this share of the readings of one are found in the other
NEAR, ALIKE = 0.25, 0.8
#: runs from which whole runs are what the bootstrap draws; below, stretches of runs
ENOUGH = 8
Labels = Index


def closure(
    problem: GapProblem,
    law: NoiseLaw,
    columns: Array | Sequence[Array],
    rng: np.random.Generator,
    *,
    split: Split,
    scale: float | Array = 1.0,
    draws: int = 2000,
) -> Closure:
    """Closure by effects with columns (N, k), in units of the stated noise per prior
    standard deviation.

    columns  or several such, one for each value of the effects' constants (equally
             probable before): they are weighed by the evidence of the training
             readings, fold by fold
    scale    prior standard deviation of the coefficients, one for all or (k,)
    split    `within`: a fifth of the path of every run is held out in turn, the same
             fifth of all its repeats and of both directions; `whole`: whole runs, those
             that repeat one another together, in up to five folds. Where all runs
             repeat one another each is held out by itself; with one run nothing can be:
             NaN, n = 0.

    The interval holds 95 % of a bootstrap over runs (stretches of them where they are
    few) of the ratio, a draw without a gap counting as +-inf by the sign of its gain;
    p_worse is the share of draws with a negative gain. The noise law is taken as known,
    its level too, and the folds do not depend on `rng`.
    """
    several = [columns] if isinstance(columns, np.ndarray) else list(columns)
    scaled = [
        c * np.broadcast_to(np.asarray(scale, dtype=float), c.shape[1:])
        for c in several
    ]
    if not scaled:
        raise ValueError(
            "closure: no columns are given; give (N, k), with k = 0 for no effect"
        )
    for c in scaled:
        _check(problem, c)
    noise = _Noise(problem, law)
    slopes = [np.hstack([problem.slopes, c]) for c in scaled]
    kept = [noise.precision(f, problem.residual) for f in slopes]
    n = problem.slopes.shape[1]

    def predicted(held: Index) -> tuple[Array, Array]:
        parts = [
            noise.held(held, np.column_stack([f, problem.residual])) for f in slopes
        ]
        learned = [_learn(*k, white) for k, white in zip(kept, parts, strict=True)]
        weight = np.array([evidence for _, evidence in learned])
        weight = np.exp(weight - weight.max())
        errors = [
            w[:, -1] - w[:, :-1] @ mean
            for w, (mean, _) in zip(parts, learned, strict=True)
        ]
        after = np.einsum("g,gn->n", weight / weight.sum(), np.array(errors))
        return _standardised(kept[0], n, parts[0], after)

    return _scored(problem, split, predicted, rng, draws)


def oracle_closure(
    problem: GapProblem,
    law: NoiseLaw,
    change: Array,
    rng: np.random.Generator,
    *,
    split: Split,
    draws: int = 2000,
) -> Closure:
    """Closure of whoever knows the effect's true change (N,) of the readings, in units
    of the stated noise.
    """
    _check(problem, change[:, None])
    noise, n = _Noise(problem, law), problem.slopes.shape[1]
    kept = noise.precision(problem.slopes, problem.residual)
    corrected = noise.precision(problem.slopes, problem.residual - change)

    def predicted(held: Index) -> tuple[Array, Array]:
        white = noise.held(
            held, np.column_stack([problem.slopes, problem.residual, change])
        )
        free = np.column_stack([white[:, :n], white[:, n] - white[:, n + 1]])
        mean, _ = _learn(*corrected, free)
        return _standardised(
            kept, n, white[:, : n + 1], free[:, -1] - free[:, :-1] @ mean
        )

    return _scored(problem, split, predicted, rng, draws)


def expected_gain(
    problem: GapProblem, law: NoiseLaw, change: Array, *, split: Split
) -> float:
    """Gain n (S0 - S1) that `oracle_closure` has in expectation: the energy of what the
    training readings leave unpredicted of the change (N,), in units of the stated
    noise.
    """
    silent = problem.with_residual(change)
    found = oracle_closure(
        silent, law, change, np.random.default_rng(0), split=split, draws=1
    )
    return found.n * (found.s0 - found.s1) if found.n else 0.0


def _check(problem: GapProblem, columns: Array) -> None:
    if columns.ndim != 2 or len(columns) != len(problem):
        raise ValueError(
            f"columns have the shape {columns.shape}; {len(problem)} readings need"
            f" ({len(problem)}, k)"
        )
    if not np.isfinite(columns).all():
        raise ValueError(
            f"column {int(np.flatnonzero(~np.isfinite(columns).all(axis=0))[0])} is not"
            " finite"
        )


# -- prediction ------------------------------------------------------------------------


class _Noise:
    """The noise of the runs: what held-out readings are left with once the training
    ones of their run are known.
    """

    def __init__(self, problem: GapProblem, law: NoiseLaw) -> None:
        self._blocks = problem.blocks
        self._inverse = [
            _inverse(law.block(problem, k)) for k in range(len(problem.blocks))
        ]

    def precision(self, slopes: Array, residual: Array) -> tuple[Array, Array]:
        """Posterior precision (n, n) of the coefficients of slopes (N, n), prior N(0,
        I), and its product with their mean (n,), all readings taken.
        """
        values = np.column_stack([slopes, residual])
        product = np.zeros((slopes.shape[1], values.shape[1]))
        for members, inverse in zip(self._blocks, self._inverse, strict=True):
            product += slopes[members].T @ (inverse @ values[members])
        return product[:, :-1] + np.eye(len(product)), product[:, -1]

    def held(self, held: Index, values: Array) -> Array:
        """Values (N, k) at the held-out readings less what the training readings' noise
        predicts there, whitened: in the order of `held`.

        With O the inverse covariance and O_hh = L L^T, L^-1 (O v)_h: innovations in
        terms of the precision.
        """
        white = np.empty((len(held), values.shape[1]))
        place = np.full(len(values), -1, dtype=np.intp)
        place[held] = np.arange(len(held))
        for members, inverse in zip(self._blocks, self._inverse, strict=True):
            mine = np.flatnonzero(place[members] >= 0)
            if mine.size:
                factor = linalg.cholesky(
                    inverse[np.ix_(mine, mine)], lower=True, check_finite=False
                )
                scored = inverse[mine] @ values[members]
                white[place[members[mine]]] = linalg.solve_triangular(
                    factor, scored, lower=True, check_finite=False
                )
        return white


def _inverse(covariance: Array) -> Array:
    factor = linalg.cho_factor(covariance, lower=True, check_finite=False)
    return np.asarray(
        linalg.cho_solve(factor, np.eye(len(covariance)), check_finite=False)
    )


def _learn(precision: Array, product: Array, white: Array) -> tuple[Array, float]:
    """Mean (n,) of the coefficients from the training readings, and their log evidence
    up to a constant.

    precision, product of all readings, less what the held-out ones, `white` (m, n + 1),
    add to them.
    """
    slopes, residual = white[:, :-1], white[:, -1]
    factor = linalg.cholesky(
        precision - slopes.T @ slopes, lower=True, check_finite=False
    )
    half = linalg.solve_triangular(
        factor, product - slopes.T @ residual, lower=True, check_finite=False
    )
    mean = linalg.solve_triangular(
        factor, half, lower=True, trans="T", check_finite=False
    )
    return mean, 0.5 * float(half @ half) - float(np.log(np.diag(factor)).sum())


def _standardised(
    kept: tuple[Array, Array], n: int, white: Array, after: Array
) -> tuple[Array, Array]:
    """Held-out residuals (m,) without and with the effects, whitened by the predictive
    covariance without them.

    kept   precision and product of all readings; the first n coefficients are the
           parameters
    white  (m, .) held-out slopes of the parameters first, residuals last;  after (m,)
           residuals with the effects
    """
    alone = np.column_stack([white[:, :n], white[:, -1]])
    precision, product = kept[0][:n, :n], kept[1][:n]
    mean, _ = _learn(precision, product, alone)
    slopes = alone[:, :-1]
    root = linalg.cholesky(
        precision - slopes.T @ slopes, lower=True, check_finite=False
    )
    spread = linalg.solve_triangular(root, slopes.T, lower=True, check_finite=False)
    factor = linalg.cholesky(
        np.eye(len(alone)) + spread.T @ spread, lower=True, check_finite=False
    )
    both = np.column_stack([alone[:, -1] - slopes @ mean, after])
    done = linalg.solve_triangular(factor, both, lower=True, check_finite=False)
    return done[:, 0], done[:, 1]


# -- scores ----------------------------------------------------------------------------


def _scored(
    problem: GapProblem,
    split: Split,
    predicted: Callable[[Index], tuple[Array, Array]],
    rng: np.random.Generator,
    draws: int,
) -> Closure:
    """Closure over all folds; `predicted` gives held-out readings' whitened residuals
    without and with the effects.
    """
    paths = _Paths(problem)
    fold, unit = paths.within() if split == "within" else paths.whole()
    before, after = np.zeros(len(problem)), np.zeros(len(problem))
    held_out = [np.flatnonzero(fold == k) for k in range(int(fold.max()) + 1)]
    if len(held_out) < 2:
        nan = float("nan")
        return Closure(split, nan, -np.inf, np.inf, nan, nan, nan, 1.0, 0)
    for held in held_out:
        before[held], after[held] = predicted(held)
    gain = np.bincount(unit, before**2 - after**2)
    gap = np.bincount(unit, before**2 - 1.0)
    drawn = rng.multinomial(
        len(gain), np.full(len(gain), 1.0 / len(gain)), size=draws
    ).astype(float)
    low, high = np.quantile(
        _ratio(drawn @ gain, drawn @ gap), [0.025, 0.975], method="closest_observation"
    )
    there = gap.sum() > 0.0
    return Closure(
        split=split,
        value=float(gain.sum() / gap.sum()) if there else float("nan"),
        low=float(low),
        high=float(high),
        p_worse=float(np.mean(drawn @ gain < 0.0)),
        s0=float(np.mean(before**2)),
        s1=float(np.mean(after**2)),
        s_noise=1.0,
        n=len(problem),
    )


def _ratio(gain: Array, gap: Array) -> Array:
    """gain / gap; +-inf by the sign of the gain where there is no gap."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(
            gap > 0.0, gain / gap, np.where(gain == 0.0, 0.0, np.copysign(np.inf, gain))
        )


# -- what is held out ------------------------------------------------------------------


class _Paths:
    """Which runs repeat one another, and how far along its path each reading is."""

    def __init__(self, problem: GapProblem) -> None:
        joints = [
            np.repeat(state.joints[s.index[:, 0]], response.nuisances.shape[1], axis=0)
            for s, state, response in zip(
                problem.series, problem.states, problem.responses, strict=True
            )
        ]
        self._runs = problem.blocks
        self._reading = (
            problem.rows.groupby(["setup", "run", "order"], sort=False)
            .ngroup()
            .to_numpy()
        )
        self._joints = np.concatenate(joints)
        self._setup = problem.rows["setup"].to_numpy()
        self._size = len(problem)

    def within(self) -> tuple[Labels, Labels]:
        """Fold (N,) of each reading and the unit (N,) that the bootstrap draws: a fifth
        of each path, of each run.
        """
        fold = np.empty(self._size, dtype=np.intp)
        for number, runs in enumerate(self.groups()):
            rows = np.concatenate([self._runs[k] for k in runs])
            place, count = self._along(
                rows, max((self._runs[k] for k in runs), key=len)
            )
            fold[rows] = (
                place * FOLDS // count if count >= FOLDS else (place + number) % FOLDS
            )
        fold = np.unique(fold, return_inverse=True)[1]
        return fold, self._stretch(fold)

    def whole(self) -> tuple[Labels, Labels]:
        """As `within`, with the runs of a fold held out together; units are runs, or
        fifths of them.
        """
        groups = self.groups()
        if len(groups) == 1:
            groups = [[k] for k in range(len(self._runs))]
        fold, load = (
            np.empty(self._size, dtype=np.intp),
            np.zeros(min(FOLDS, len(groups))),
        )
        for runs in sorted(
            groups, key=lambda runs: -sum(len(self._runs[k]) for k in runs)
        ):
            rows = np.concatenate([self._runs[k] for k in runs])
            fold[rows] = np.argmin(load)
            load[np.argmin(load)] += len(rows)
        if len(self._runs) >= ENOUGH:
            return fold, self._stretch(np.zeros(self._size, dtype=np.intp))
        return fold, self._stretch(self.within()[0])

    def groups(self) -> list[list[int]]:
        """Numbers of the runs that follow the same path in the same set-up, whichever
        way and however often.
        """
        near = sparse.lil_matrix((len(self._runs), len(self._runs)))
        for setup in dict.fromkeys(self._setup):
            runs = [
                k
                for k, members in enumerate(self._runs)
                if self._setup[members[0]] == setup
            ]
            self._link(runs, near)
        count, label = csgraph.connected_components(near, directed=False)
        return [np.flatnonzero(label == k).tolist() for k in range(count)]

    def _link(self, runs: list[int], near: sparse.lil_matrix) -> None:
        """Mark pairs of runs of which one has nearly all its poses in the other."""
        points = [np.unique(self._joints[self._runs[k]], axis=0) for k in runs]
        owner = np.repeat(np.arange(len(runs)), [len(p) for p in points])
        together = np.vstack(points)
        pairs = spatial.cKDTree(together).query_pairs(
            self._tolerance(runs, together), output_type="ndarray"
        )
        pairs = np.vstack([pairs, pairs[:, ::-1]])
        seen = np.unique(np.column_stack([pairs[:, 0], owner[pairs[:, 1]]]), axis=0)
        shared = np.zeros((len(runs), len(runs)))
        np.add.at(shared, (owner[seen[:, 0]], seen[:, 1]), 1.0)
        for a, b in np.argwhere(shared >= ALIKE * np.bincount(owner)[:, None]):
            near[runs[a], runs[b]] = 1.0

    def _tolerance(self, runs: list[int], together: Array) -> float:
        """Distance in the joints below which two poses count as the same."""
        steps = [
            np.linalg.norm(np.diff(self._joints[self._runs[k]], axis=0), axis=1)
            for k in runs
        ]
        moved = np.concatenate(steps)
        extent = float(np.linalg.norm(np.ptp(together, axis=0)))
        moved = moved[moved > 1e-3 * extent]
        return max(
            NEAR * float(np.median(moved)) if moved.size else 0.0, 1e-3 * extent, 1e-12
        )

    def _along(self, rows: Index, longest: Index) -> tuple[Labels, int]:
        """Place of each row among the poses of the longest run, in its order, and how
        many places there are.
        """
        _, first = np.unique(self._reading[longest], return_index=True)
        template = self._joints[longest[np.sort(first)]]
        _, nearest = spatial.cKDTree(template).query(self._joints[rows])
        used, place = np.unique(nearest, return_inverse=True)
        return place.astype(np.intp), len(used)

    def _stretch(self, part: Labels) -> Labels:
        """Number of each reading's (run, part)."""
        run = np.empty(self._size, dtype=np.intp)
        for k, members in enumerate(self._runs):
            run[members] = k
        return (
            np.unique(np.column_stack([run, part]), axis=0, return_inverse=True)[1]
            .astype(np.intp)
            .ravel()
        )
