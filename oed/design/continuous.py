"""Designs whose points move freely: N points v_i in a box, M = M0 + sum_i X(v_i)^T
X(v_i), X a CasADi function.

`optimise` is an iterated local search whose step is exchange in continuous coordinates
(Meyer and Nachtsheim 1995, Technometrics 37, 60-69, without their grid): point after
point, coordinate after coordinate, the value is taken that is best with all else held.
With the point taken out, R its M^-1 and S = X R X^T, this is exact and cheap:

    D         gains log det(1 + S)
    variance  gains tr((1 + S)^-1 X Q X^T),                          Q = R W R
    Ds        gains log det(1 + S) - log det(1 + X Q X^T),           Q = N (N^T M N)^-1 N^T

Where X is affine in a coordinate and has one row, all three grow towards an end of its
range, and the ends are all that is tried; elsewhere values in between are drawn anew
for each sweep. A change of v_j touches only the entries of X that hold it: S is updated
by these alone, and one sweep over all points is one CasADi call. Then `polish`: bounded
quasi-Newton over all points with gradients from X's reverse derivatives, and IPOPT
where a slope or a constraint is left.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from scipy import optimize as scipy_optimize

from oed.arrays import Array
from oed.batch import Batched
from oed.design import smooth
from oed.design.coordinate_sweep import Sweep
from oed.design.smooth import Smooth

#: values tried between the ends of a coordinate that X is not affine in
BETWEEN = 5
#: smallest gain of a sweep that is followed by another: where ends are all there is,
#: and where values are drawn
GAIN, COARSE = 1e-9, 1e-4
SWEEPS = 60
#: how much worse, typically, a design may be for the search to go on from it; shrinks
#: to nothing
LEEWAY = 3e-3
#: a constraint may be missed by this much
SLACK = 1e-9
#: greatest slope (per range of a coordinate, free to move) at which a design counts as
#: stationary
STATIONARY = 1e-6
#: relative ridge that keeps the inverse of a design that is singular
RIDGE = 1e-10
IPOPT: Any = {
    "ipopt": {
        "hessian_approximation": "limited-memory",
        "limited_memory_max_history": 20,
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-9,
        "max_iter": 500,
        "bound_relax_factor": 0.0,
        "bound_push": 1e-6,
        "bound_frac": 1e-6,
        "mu_init": 1e-5,
    },
    "print_time": False,
}


@dataclasses.dataclass(frozen=True)
class Continuous:
    """A design with free points.

    points     (N, d)
    value      criterion
    start      criterion of the best start, before any step (`polish`: of the design
               handed in)
    rounds     rounds of local search
    stationary whether, to first order, no point can do better within its box
    words      how it came about
    """

    points: Array
    value: float
    start: float
    rounds: int
    stationary: bool
    words: str


class Problem:
    """Points in a box with their rows, compiled: v (d,) -> X (k, n); constraints g(v)
    <= 0.
    """

    def __init__(
        self,
        rows: Any,
        lower: Array,
        upper: Array,
        criterion: Smooth | None = None,
        prior: Array | None = None,
        constraints: Any | None = None,
    ) -> None:
        self.lower, self.upper = (
            np.asarray(lower, dtype=float),
            np.asarray(upper, dtype=float),
        )
        if (
            self.lower.shape != self.upper.shape
            or self.lower.ndim != 1
            or not (self.lower < self.upper).all()
        ):
            raise ValueError("lower and upper must be vectors (d,) with lower < upper")
        if not (np.isfinite(self.lower).all() and np.isfinite(self.upper).all()):
            raise ValueError("every coordinate needs a finite range")
        if rows.numel_in(0) != len(self.lower):
            raise ValueError(
                f"rows take {rows.numel_in(0)} coordinates, the box has"
                f" {len(self.lower)}"
            )
        v = ca.SX.sym("v", len(self.lower))
        x = ca.densify(rows(v))
        self.shape: tuple[int, int] = x.shape
        self.criterion = smooth.determinant() if criterion is None else criterion
        self.base = (
            np.zeros((x.shape[1], x.shape[1]))
            if prior is None
            else np.asarray(prior, dtype=float)
        )
        self.rows = ca.Function("rows", [v], [x])
        self.limits = (
            None
            if constraints is None
            else ca.Function("limits", [v], [ca.vec(constraints(v))])
        )
        seed = ca.SX.sym("seed", x.numel())
        self._blocks = Batched("blocks", [v], [ca.vec(x.T)])
        self._back = Batched("back", [v, seed], [ca.jtimes(ca.vec(x.T), v, seed, True)])
        self._limits = (
            None if self.limits is None else Batched("limits", [v], [self.limits(v)])
        )

    def blocks(self, points: Array) -> Array:
        """X (N, k, n)."""
        return self._blocks(points)[0].reshape(len(points), *self.shape)

    def information(self, points: Array) -> Array:
        """M (n, n)."""
        flat = self.blocks(points).reshape(-1, self.shape[1])
        return np.asarray(self.base + flat.T @ flat)

    def value(self, points: Array) -> float:
        """Criterion of a design (N, d); -inf where it is singular or a number is
        missing.
        """
        m = self.information(points)
        return self.criterion.value(m) if np.isfinite(m).all() else -np.inf

    def slope(self, points: Array) -> tuple[float, Array]:
        """Criterion and its gradient (N, d); -inf and zeros where it is singular."""
        blocks = self.blocks(points)
        flat = blocks.reshape(-1, self.shape[1])
        m = self.base + flat.T @ flat
        value = self.criterion.value(m) if np.isfinite(m).all() else -np.inf
        if not np.isfinite(value):
            return -np.inf, np.zeros_like(points)
        seed = 2.0 * flat @ self.criterion.slope(m)
        return value, self._back(points, seed.reshape(len(points), -1))[0]

    def feasible(self, points: Array) -> bool:
        """Whether the points keep to box and constraints."""
        inside = bool(((points >= self.lower) & (points <= self.upper)).all())
        return inside and (
            self._limits is None or bool((self._limits(points)[0] <= SLACK).all())
        )

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Random points (count, d). Raises ValueError where hardly any keeps the
        constraints.
        """
        found = np.zeros((0, len(self.lower)))
        for _ in range(1000):
            more = rng.uniform(self.lower, self.upper, (count, len(self.lower)))
            if self._limits is not None:
                more = more[(self._limits(more)[0] <= 0.0).all(axis=1)]
            found = np.vstack([found, more])
            if len(found) >= count:
                return found[:count]
        raise ValueError(
            "hardly any point of the box keeps the constraints: narrow the box to where"
            " they hold"
        )


def optimise(
    rows: Any,
    lower: Array,
    upper: Array,
    size: int,
    rng: np.random.Generator,
    criterion: Smooth | None = None,
    prior: Array | None = None,
    constraints: Any | None = None,
    starts: int = 20,
    rounds: int = 400,
    seconds: float | None = None,
) -> Continuous:
    """The best design of `size` points found.

    rows: CasADi function v (d,) -> X (k, n), whitened rows of a point; lower, upper
    (d,): the box; prior (n, n): information held already; constraints: CasADi function
    v -> g, wanted <= 0. `starts` random designs are improved, then the best is shaken
    and improved in `rounds` rounds; `seconds` ends the search early, and with it goes
    sameness from machine to machine. "power" is searched as A, and polished as itself.
    Raises ValueError for a box that is none, points the constraints refuse, or too few
    readings for the columns.
    """
    problem = Problem(rows, lower, upper, criterion, prior, constraints)
    if prior is None and size * problem.shape[0] < problem.shape[1]:
        raise ValueError(
            f"{size} points of {problem.shape[0]} rows cannot determine"
            f" {problem.shape[1]} columns"
        )
    begin = time.perf_counter()
    search = _Exchange(problem, size)

    def over() -> bool:
        return seconds is not None and time.perf_counter() - begin > seconds

    best, value, first = problem.draw(size, rng), -np.inf, -np.inf
    for _ in range(max(1, starts)):
        start = problem.draw(size, rng)
        first = max(first, problem.value(start))
        points = search.improve(start, rng)
        reached = problem.value(points)
        if reached > value:
            best, value = points, reached
        if over():
            break
    best, done = _shaken(search, best, rng, rounds, over)
    polished = _polished(problem, best)
    words = (
        f"{starts} starts and {done} rounds of exchange in continuous coordinates;"
        f" {polished.words}"
    )
    return dataclasses.replace(polished, start=first, rounds=done, words=words)


def polish(
    rows: Any,
    start: Array,
    lower: Array,
    upper: Array,
    criterion: Smooth | None = None,
    prior: Array | None = None,
    constraints: Any | None = None,
) -> Continuous:
    """A design (N, d) moved to the next local optimum; the start itself where nothing
    better is found.

    Arguments as for `optimise`. Raises ValueError where the start leaves box or
    constraints.
    """
    problem = Problem(rows, lower, upper, criterion, prior, constraints)
    start = np.asarray(start, dtype=float)
    if start.ndim != 2 or start.shape[1] != len(problem.lower):
        raise ValueError(f"a design is (N, {len(problem.lower)}), not {start.shape}")
    if not problem.feasible(start):
        raise ValueError("the start leaves its box or its constraints")
    return _polished(problem, start)


# -- search ----------------------------------------------------------------------------


class _Exchange:
    """Sweeps until nothing is gained."""

    def __init__(self, problem: Problem, size: int) -> None:
        self.problem = problem
        guide = (
            smooth.variance()
            if problem.criterion.name == "power"
            else problem.criterion
        )
        self.guide = guide
        self.sweep = Sweep(
            problem.rows,
            problem.lower,
            problem.upper,
            size,
            guide,
            BETWEEN,
            problem.limits,
            SLACK,
        )
        self.tolerance = GAIN if self.sweep.straight else COARSE

    def improve(self, points: Array, rng: np.random.Generator) -> Array:
        """Points (N, d), never worse by the criterion exchanged for."""
        m = self.problem.information(points)
        value = self.guide.value(m)
        for _ in range(SWEEPS):
            ridged: Array = m + np.diag(
                RIDGE * np.maximum(np.diag(m), np.finfo(float).tiny)
            )
            inverse: Array = np.asarray(np.linalg.inv(ridged), dtype=float)
            moved = self.sweep(
                inverse, self.guide.partner(ridged, inverse), points, rng
            )
            after = self.problem.information(moved)
            reached = self.guide.value(after)
            if not reached > value:
                break
            gained, points, m, value = reached - value, moved, after, reached
            if gained < self.tolerance:
                break
        return points


def _shaken(
    search: _Exchange,
    best: Array,
    rng: np.random.Generator,
    rounds: int,
    over: Callable[[], bool],
) -> tuple[Array, int]:
    """Iterated local search: a few coordinates are moved, all is improved, and what is
    hardly worse is gone on from.
    """
    problem, done = search.problem, 0
    here, value = best, problem.value(best)
    best_value = value
    for k in range(rounds):
        if over():
            break
        points = search.improve(_moved(problem, here, rng), rng)
        reached = problem.value(points)
        if reached >= value - LEEWAY * (1.0 - k / rounds) * rng.exponential():
            here, value = points, reached
        if value > best_value:
            best, best_value = here, value
        done += 1
    return best, done


def _moved(problem: Problem, points: Array, rng: np.random.Generator) -> Array:
    """A few coordinates mirrored in their ranges, or points drawn anew."""
    moved = points.copy()
    if problem.limits is not None or rng.uniform() < 0.2:
        out = rng.choice(
            len(points),
            size=int(rng.integers(1, min(3, len(points)) + 1)),
            replace=False,
        )
        moved[out] = problem.draw(len(out), rng)
        return moved
    count = min(int(rng.integers(3, 16)), moved.size)
    row, column = np.unravel_index(
        rng.choice(moved.size, size=count, replace=False), moved.shape
    )
    moved[row, column] = (
        problem.lower[column] + problem.upper[column] - moved[row, column]
    )
    return moved


# -- polishing -------------------------------------------------------------------------


def _polished(problem: Problem, start: Array) -> Continuous:
    begin = best = problem.value(start)
    points, words = start, []
    if problem.limits is None and np.isfinite(best):
        moved = _quasi_newton(problem, points)
        reached = problem.value(moved)
        if reached > best:
            points, best = moved, reached
            words.append(f"quasi-Newton gained {best - begin:.3g}")
    still = _still(problem, points)
    if not still and np.isfinite(best):
        moved = _interior(problem, points)
        reached = problem.value(moved) if problem.feasible(moved) else -np.inf
        if reached > best:
            words.append(f"IPOPT gained {reached - best:.3g}")
            points, best = moved, reached
            still = _still(problem, points)
    told = "; ".join(words) or "no slope was left to polish along"
    return Continuous(points, best, begin, 0, still, told)


def _still(problem: Problem, points: Array) -> bool:
    """Whether no coordinate that is free to move has a slope."""
    value, slope = problem.slope(points)
    slope = slope * (problem.upper - problem.lower)
    edge = 1e-9 * (problem.upper - problem.lower)
    pushed = ((points <= problem.lower + edge) & (slope < 0)) | (
        (points >= problem.upper - edge) & (slope > 0)
    )
    return bool(
        np.isfinite(value) and np.abs(np.where(pushed, 0.0, slope)).max() < STATIONARY
    )


def _quasi_newton(problem: Problem, start: Array) -> Array:
    """Bounded L-BFGS over all points, in shares of their ranges."""
    span = problem.upper - problem.lower

    def cost(z: Array) -> tuple[float, Array]:
        value, slope = problem.slope(problem.lower + z.reshape(start.shape) * span)
        return (
            (-value, -(slope * span).ravel())
            if np.isfinite(value)
            else (1e30, np.zeros_like(z))
        )

    z = ((start - problem.lower) / span).ravel()
    options = {"maxiter": 500, "ftol": 1e-15, "gtol": STATIONARY / 10, "maxcor": 20}
    found = scipy_optimize.minimize(
        cost, z, jac=True, method="L-BFGS-B", bounds=[(0, 1)] * z.size, options=options
    )
    return np.asarray(
        np.clip(
            problem.lower + found.x.reshape(start.shape) * span,
            problem.lower,
            problem.upper,
        )
    )


def _interior(problem: Problem, start: Array) -> Array:
    """IPOPT over all points, with constraints."""
    count, n = len(start), problem.shape[1]
    v = ca.SX.sym("v", start.shape[1])
    place = ca.DM(problem.lower) + v * ca.DM(problem.upper - problem.lower)
    outputs = [
        problem.rows(place).T,
        ca.SX(0, 1) if problem.limits is None else problem.limits(place),
    ]
    mapped = ca.Function("point", [v], outputs, {"cse": True}).map(count)
    m = ca.SX.sym("m", n, n)
    judge = ca.Function("judge", [m], [problem.criterion.expression(m)], {"cse": True})
    z = ca.MX.sym("z", start.shape[1], count)
    columns, limits = mapped(z)
    nlp: Any = {
        "x": ca.vec(z),
        "f": -judge(ca.DM(problem.base) + columns @ columns.T),
        "g": ca.vec(limits),
    }
    shares = np.clip(
        (start - problem.lower) / (problem.upper - problem.lower), 0.0, 1.0
    )
    found = ca.nlpsol("polish", "ipopt", nlp, IPOPT)(
        x0=shares.ravel(), lbx=0.0, ubx=1.0, lbg=-np.inf, ubg=0.0
    )
    moved = np.asarray(found["x"]).reshape(start.shape)
    return np.asarray(
        np.clip(
            problem.lower + moved * (problem.upper - problem.lower),
            problem.lower,
            problem.upper,
        )
    )
