"""Most probable parameters of many machines at once, by damped Gauss-Newton steps.

Minimised is, for each of m machines,

    |r(z)|^2 + |w z|^2,        r(z) = W (y - f(z)),

W whitening the noise, z the unknowns in units of their prior (w = 1), or of a nearly
flat one. A step is a full Gauss-Newton step, or one damped until it does not raise the
sum and is not too long (Levenberg 1944, Marquardt 1963): far from nominal lie spurious
minima. The step d promises to lower the sum by
d^T (A^T A + w^2) d, A the slopes: the squared distance to the minimum in posterior
standard deviations. A machine has converged when this distance is below `PRECISION`,
or below what rounding of the readings leaves; it takes that last step too. Where
residuals are large and the readings curved, Gauss-Newton steps overshoot by nearly their
length. From the first near the minimum that does, the damping is that with which the last
step would have ended where the gradient along it is 0.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from oed.base import Array, Index, Mask
from oed.mechanism import AssemblyError

#: distance to the minimum, posterior standard deviations, below which a step is the last
MAX_LAST_STEP = 1e-7
MAX_STEPS = 60  #: steps of each machine
MAX_TRIALS = 16  #: steps tried from a point, each more damped
DAMPING_GROWTH = 10.0  #: factor on the damping after a step that raises the sum
DAMPING_DECAY = 0.01  #: factor on the damping after a step that does not
#: gradient along a step at its end, over minus that at its start, from which it overshoots
OVERSHOOT_GRADIENT_RATIO = 0.25
#: distance to the minimum, posterior standard deviations, within which that counts
OVERSHOOT_DISTANCE = 3.0
#: longest first step, tolerances for each unknown: spurious minima lie farther away
FIRST_LENGTH = 3.0
LENGTH_GROWTH = 4.0  #: factor on the longest step after a step as long as that
READINGS_TOLERANCE = 1e-15  #: relative rounding error of readings
SUM_TOLERANCE = 1e-12  #: relative rounding error of sums of squares
FLAT_PRIOR = 1e-3  #: weight below which a prior is nearly flat
#: curvature over the largest below which a direction takes no step
FLAT_CURVATURE = 1e-14


class LeastSquares(Protocol):
    """What is minimised, machine by machine; unknowns z (k,), readings N."""

    @property
    def magnitude(self) -> Array:
        """Sizes (m, N) of the whitened lengths whose difference a residual is."""

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (s, N) at z (s, k); not finite where none."""

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened slopes (s, N, k) of the predicted readings. Raises AssemblyError."""


@dataclasses.dataclass(frozen=True, eq=False)
class Minima:
    """Where the sums of m machines are least."""

    z: Array  #: (m, k)
    #: (m, N) whitened; not finite where no sum can be computed, or no slopes
    residual: Array
    slopes: Array  #: (m, N, k) whitened, of the point before the last step
    converged: Mask  #: (m,) whether the machine's steps ended at a minimum
    evaluations: Index  #: (m,) of the residuals


def minimise(
    problem: LeastSquares,
    start: Array,
    *,
    weight: Array | float = 1.0,
    precision: float = MAX_LAST_STEP,
    steps: int = MAX_STEPS,
) -> Minima:
    """Minima from z `start` (m, k), of prior weights w (k,), in so many steps a
    machine.

    precision  distance to the minimum, in posterior sd, below which a step is the last

    A machine whose residuals or slopes cannot be computed does not converge.
    """
    search = _Steps(problem, start, np.broadcast_to(weight, start.shape[1:]))
    active = np.flatnonzero(np.isfinite(search.cost))
    for _ in range(steps):
        active = search.step(active, precision)
        if not active.size:
            break
    return search.minima()


class _Steps:
    """Points of m machines and their steps."""

    def __init__(self, problem: LeastSquares, start: Array, weight: Array) -> None:
        count = len(start)
        every = np.arange(count)
        self._problem, self._weight = problem, weight
        self._z = np.array(start, dtype=float)
        self._residual = problem.residuals(every, self._z)
        self._slopes = np.zeros((*self._residual.shape, start.shape[1]))
        self._converged = np.zeros(count, dtype=bool)
        self._evaluations = np.ones(count, dtype=np.intp)
        self._damping = np.zeros(count)
        # of the last steps: the steps, gradient at their start, curvature of the model
        self._last, self._descent = np.zeros_like(self._z), np.zeros(count)
        self._curvature = np.zeros(count)
        self._overshot = np.zeros(count, dtype=bool)
        self._longest = np.full(count, FIRST_LENGTH * np.sqrt(max(start.shape[1], 1)))
        self._rounding = READINGS_TOLERANCE * problem.magnitude
        self._precision = np.linalg.norm(self._rounding, axis=1)
        self.cost = self._costs(self._z, self._residual)

    def minima(self) -> Minima:
        return Minima(
            self._z, self._residual, self._slopes, self._converged, self._evaluations
        )

    def step(self, machines: Index, precision: float) -> Index:
        """Moves machines by a step each; returns those that need a further one."""
        machines = self._linearise(machines)
        if not machines.size:
            return machines
        system = _StepSystem.of(
            self._slopes[machines],
            self._residual[machines],
            self._z[machines],
            self._weight,
        )
        self._adapt_damping(machines, system)
        near = system.distance() < np.maximum(precision, self._precision[machines])
        undamped = np.zeros(int(near.sum()))
        self._finish(machines[near], system.step(near, undamped))
        return self._descend(machines[~near], system, np.flatnonzero(~near))

    def _adapt_damping(self, machines: Index, system: _StepSystem) -> None:
        """Damping for the next steps, by the gradient at the end of the last ones.

        With the curvature c of the model and h of the sum along a step, the gradient at its
        end is 1 - h / (c + damping) of that at its start: the damping h - c is best.
        """
        along = (system.pull * self._last[machines]).sum(axis=1)
        start = self._descent[machines]
        ratio = np.divide(along, start, out=np.zeros_like(start), where=start > 0.0)
        self._overshot[machines] |= (ratio < -OVERSHOOT_GRADIENT_RATIO) & (
            start < OVERSHOOT_DISTANCE**2
        )
        damping = self._damping[machines]
        best = damping * (1.0 - ratio) - ratio * self._curvature[machines]
        best = np.maximum(best, 0.0)
        self._damping[machines] = np.where(
            self._overshot[machines], best, DAMPING_DECAY * damping
        )

    def _linearise(self, machines: Index) -> Index:
        """Computes slopes; returns the machines that have them."""
        try:
            self._slopes[machines] = self._problem.slopes(machines, self._z[machines])
        except AssemblyError:
            if len(machines) == 1:
                self._residual[machines] = np.nan
                return machines[:0]
            parts = [self._linearise(machines[k : k + 1]) for k in range(len(machines))]
            return np.concatenate(parts)
        return machines

    def _finish(self, machines: Index, step: Array) -> None:
        """The last step of machines: so short that the readings are linear in it."""
        change = self._slopes[machines] @ step[:, :, None]
        self._z[machines] += step
        self._residual[machines] -= change[:, :, 0]
        self._converged[machines] = True

    def _descend(self, machines: Index, system: _StepSystem, rows: Index) -> Index:
        """Machines, `rows` in the system, that a least damped step lowers."""
        waiting = np.arange(len(machines))
        for _ in range(MAX_TRIALS):
            if not waiting.size:
                break
            trying = machines[waiting]
            step, limited = self._limited_step(trying, system, rows[waiting])
            lower = self._move(trying, step)
            self._longest[trying[lower & limited]] *= LENGTH_GROWTH
            moved, of_moved = trying[lower], rows[waiting[lower]]
            self._last[moved] = step[lower]
            self._descent[moved] = (system.pull[of_moved] * step[lower]).sum(axis=1)
            curvature = system.mean_curvature(of_moved, self._damping[moved])
            self._curvature[moved] = curvature
            waiting = waiting[~lower]
            least = system.least_damping()[rows[waiting]]
            self._raise_damping(machines[waiting], least)
        return np.delete(machines, waiting)

    def _limited_step(
        self, machines: Index, system: _StepSystem, rows: Index
    ) -> tuple[Array, Mask]:
        """Steps (s, k), damped until none is too long, and which were damped for that."""
        limited = np.zeros(len(machines), dtype=bool)
        for _ in range(MAX_TRIALS):
            step = system.step(rows, self._damping[machines])
            far = np.linalg.norm(step[:, self._weight >= FLAT_PRIOR], axis=1)
            long = far > self._longest[machines]
            if not long.any():
                break
            limited |= long
            self._raise_damping(machines[long], system.least_damping()[rows[long]])
        return step, limited

    def _raise_damping(self, machines: Index, least: Array) -> None:
        raised = np.maximum(self._damping[machines] * DAMPING_GROWTH, least)
        self._damping[machines] = raised

    def _move(self, machines: Index, step: Array) -> Mask:
        """Moves machines (s,) where that does not raise their sum; says which."""
        z = self._z[machines] + step
        residual = self._problem.residuals(machines, z)
        cost = self._costs(z, residual)
        lower = np.asarray(
            cost <= self.cost[machines] + self._rounding_of_sums(machines)
        )
        moved = machines[lower]
        self._z[moved], self._residual[moved] = z[lower], residual[lower]
        self.cost[moved] = cost[lower]
        self._evaluations[machines] += 1
        return lower

    def _costs(self, z: Array, residual: Array) -> Array:
        """Sums (s,) of squares; infinite where they cannot be computed."""
        of_prior = ((self._weight * z) ** 2).sum(axis=1)
        cost = (residual**2).sum(axis=1) + of_prior
        return np.where(np.isfinite(cost), cost, np.inf)

    def _rounding_of_sums(self, machines: Index) -> Array:
        """Changes (s,) of the sums that rounding alone may cause."""
        of_readings = np.abs(self._residual[machines]) * self._rounding[machines]
        return np.asarray(
            2.0 * of_readings.sum(axis=1) + SUM_TOLERANCE * self.cost[machines]
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _StepSystem:
    """Normal equations of s machines, diagonal in orthogonal directions.

    Lengths are in units of the prior. For an unknown whose prior is nearly flat, they are
    in units of what the readings determine.
    """

    pull: Array  #: (s, k) minus half the gradient of the sum over z
    curvature: Array  #: (s, k) of the directions, ascending
    directions: Array  #: (s, k, k) columns
    descent: Array  #: (s, k) of the pull along the directions

    @classmethod
    def of(cls, slopes: Array, residual: Array, z: Array, weight: Array) -> _StepSystem:
        """The system of slopes (s, N, k) and residuals (s, N) at z (s, k)."""
        transposed = slopes.swapaxes(1, 2)
        descent = (transposed @ residual[:, :, None])[:, :, 0] - weight**2 * z
        normal = transposed @ slopes + np.diag(weight**2)
        of_readings = np.sqrt(np.einsum("skk->sk", normal))
        size = np.where(weight < FLAT_PRIOR, of_readings, weight)
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        scaled = normal * scale[:, :, None] * scale[:, None, :]
        curvature, vectors = np.linalg.eigh(scaled)
        along = (vectors.swapaxes(1, 2) @ (scale * descent)[:, :, None])[:, :, 0]
        return cls(descent, curvature, scale[:, :, None] * vectors, along)

    def distance(self) -> Array:
        """Distances (s,) to the minima, in posterior standard deviations."""
        moves = self._moves(slice(None), np.zeros(len(self.descent)))
        return np.asarray(np.sqrt((self.descent * moves).sum(axis=1)))

    def least_damping(self) -> Array:
        """The damping (s,) that halves a step along the flattest direction."""
        return np.maximum(self.curvature[:, 0], FLAT_CURVATURE)

    def mean_curvature(self, rows: Index, damping: Array) -> Array:
        """Curvature (s,) along the steps of some rows."""
        squares = self._moves(rows, damping) ** 2
        total = squares.sum(axis=1)
        weighted = (self.curvature[rows] * squares).sum(axis=1)
        moving = np.where(total > 0.0, total, 1.0)
        return np.where(total > 0.0, weighted / moving, 0.0)

    def step(self, rows: Index | Mask, damping: Array) -> Array:
        """Steps (s, k) of z of some rows, each with its damping (s,)."""
        moves = self._moves(rows, damping)
        return (self.directions[rows] @ moves[:, :, None])[:, :, 0]

    def _moves(self, rows: Index | Mask | slice, damping: Array) -> Array:
        """Moves (s, k) along the directions; none along flat ones."""
        curvature, descent = self.curvature[rows], self.descent[rows]
        flat = curvature <= FLAT_CURVATURE * curvature[:, -1:]
        moves = np.zeros_like(descent)
        damped = curvature + damping[:, None]
        return np.divide(descent, damped, out=moves, where=~flat)
