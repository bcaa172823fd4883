"""A primal-dual interior point for the extreme eigenvalues of an information matrix.

The problem

    maximise  l_min(M) - z l_max(M),   M = M0 + sum_i w_i A_i,  A_i = X_i^T X_i,   0 <= w_i <= cap_i,  sum_i w_i = N

is to maximise t - z r with S1 = M - t 1 and S2 = r 1 - M positive semidefinite. With
their duals Y and Z, and a, b those of the limits of w, predictor and corrector steps
follow the path Y S1 = Z S2 = w a = (cap - w) b = mu (Helmberg, Rendl, Vanderbei,
Wolkowicz 1996, SIAM J. Optim. 6, 342-361; Mehrotra 1992, SIAM J. Optim. 2, 575-601).
Each step is one linear system of the size of the active set, with entries
tr(A_i S1^-1 A_j Y) + tr(A_i S2^-1 A_j Z) (`oed.design.interior_step`).

S1 is stored as T S1 T^T with T M T^T = 1 at a good plan, so that eigenvalues may spread
over ten decades. S2 is rounded against l_max, which is all it needs. For kappa,
z = l_min / l_max follows the plan (`oed.design.condition`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.design import relaxation
from oed.design.blocks import as_blocks, information
from oed.design.interior_step import Iterate, StepSystem

#: share of a step to the border of the feasible set
STAY_INSIDE = 0.95
#: shares of both steps below which the path ends
LEAST_STEP = 1e-8


@dataclasses.dataclass(frozen=True, eq=False)
class InteriorProblem:
    """Candidates, prior information, and a transformation T for good rounding.

    blocks      (C, k, n) X_i
    base        (n, n) M0
    size        N
    caps        (C,)
    start       (C,) weights of a good plan
    turn        T (n, n), with T M T^T = 1 at `start`
    white       (C, k, n) X_i T^T
    white_base  (n, n) T M0 T^T
    square      (n, n) T T^T
    """

    blocks: Array
    base: Array
    size: float
    caps: Array
    start: Array
    turn: Array
    white: Array
    white_base: Array
    square: Array

    def extreme_eigenvalues(self, active: Index, weights: Array) -> tuple[float, float]:
        """l_min and l_max of M; l_min comes from M^-1, to a rounding of its own."""
        white = self.white_base + information(self.white[active], weights)
        inverse = self.turn.T @ np.linalg.inv(white) @ self.turn
        m = self.base + information(self.blocks[active], weights)
        least = 1.0 / float(np.linalg.eigvalsh(inverse)[-1])
        return least, float(np.linalg.eigvalsh(m)[-1])

    def subset(self, active: Index) -> InteriorProblem:
        """The problem over a part of the candidates."""
        return dataclasses.replace(
            self,
            blocks=self.blocks[active],
            caps=self.caps[active],
            start=self.start[active],
            white=self.white[active],
        )


def build_problem(
    rows: Array, size: float, prior: Array | None, cap: Array | float
) -> InteriorProblem:
    """The problem of candidates (C, n) or (C, k, n).

    Raises ValueError where the caps cannot carry the size, or where candidates and
    prior leave directions undetermined.
    """
    blocks = as_blocks(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    relaxation.check_caps(caps, size, cap)
    base = np.zeros((n, n)) if prior is None else np.asarray(prior, dtype=float)
    try:
        _check_determined(base + information(blocks, caps * (size / caps.sum())))
        start = relaxation.relax(blocks, size, base, caps, 1e-2).weights
        turn = np.linalg.inv(np.linalg.cholesky(base + information(blocks, start)))
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "candidates and prior leave directions undetermined: restrict the problem"
            " to the estimable subspace"
        ) from error
    return InteriorProblem(
        blocks=blocks,
        base=base,
        size=size,
        caps=caps,
        start=start,
        turn=turn,
        white=blocks @ turn.T,
        white_base=turn @ base @ turn.T,
        square=np.asarray(turn @ turn.T),
    )


def _check_determined(m: Array) -> None:
    """Raises LinAlgError where M (n, n) is singular, whatever its columns' units."""
    n = len(m)
    scale = np.sqrt(np.diag(m))
    if not scale.all():
        raise np.linalg.LinAlgError("a column is zero")
    np.linalg.cholesky(m / np.outer(scale, scale) - 1e-14 * n * np.eye(n))


class InteriorPath:
    """The iterate of the method over an active set, and its steps.

    y and s1 are in the transformed coordinates, T^-T Y T^-1 and T S1 T^T.
    """

    def __init__(
        self,
        problem: InteriorProblem,
        slope: float | None,
        weights: Array,
        centre: float,
        known_slope: float = 0.0,
    ) -> None:
        """Starts at `weights` moved by a share `centre` towards even ones.

        The distance to l_min is the same share of it. Without a slope z, it is that of
        the weights, or the `known_slope` of a better plan.
        """
        self.problem, self.slope_is_free = problem, slope is None
        caps, n = problem.caps, len(problem.base)
        even = problem.size * caps / caps.sum()
        w = (1.0 - centre) * weights + centre * even
        least, largest = problem.extreme_eigenvalues(np.arange(len(caps)), w)
        self.slope = max(least / largest, known_slope) if slope is None else slope
        t, r = (1.0 - centre) * least, 0.0
        inverse = np.linalg.inv(self._low(w, t))
        mu = 1.0 / float(np.sum(inverse * problem.square))
        y: Array = np.asarray(mu * inverse)
        z: Array = np.zeros((n, n))
        if self.slope:
            r = (1.0 + centre) * largest + n * mu / self.slope
            inverse = np.linalg.inv(self._high(w, r))
            mu = max(mu, self.slope / float(np.trace(inverse)))
            z = np.asarray(self.slope * inverse / np.trace(inverse))
        self.at = Iterate(w, t, r, y, z, mu / w, mu / (caps - w))

    def _low(self, w: Array, t: float) -> Array:
        """T S1 T^T."""
        p = self.problem
        return p.white_base + information(p.white, w) - t * p.square

    def _high(self, w: Array, r: float) -> Array:
        """S2."""
        p = self.problem
        return r * np.eye(len(p.base)) - p.base - information(p.blocks, w)

    def step(self) -> bool:
        """One predictor and corrector step.

        False where rounding ends the path; the iterate is then the last sound one.
        """
        at = self.at
        try:
            low, high = self._low(at.w, at.t), self._high(at.w, at.r)
            system = StepSystem(self.problem, self.slope, at, low, high)
            now = system.complementarity(None, 0.0, 0.0)
            guess = system.move(0.0, None)
            full_primal, full_dual = min(1.0, guess.primal), min(1.0, guess.dual)
            after_guess = system.complementarity(guess, full_primal, full_dual)
            mu = now / system.order
            centring = float(np.clip((after_guess / now) ** 2, 1e-3, 1.0))
            move = system.move(centring * mu, guess)
            primal = min(1.0, STAY_INSIDE * move.primal)
            dual = min(1.0, STAY_INSIDE * move.dual)
            after = at.after(move, primal, dual)
            np.linalg.cholesky(after.y)
            if self.slope:
                np.linalg.cholesky(after.z)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            return False
        self.at = after
        return max(primal, dual) > LEAST_STEP
