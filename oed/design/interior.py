"""A primal-dual interior point for the extreme eigenvalues of an information matrix.

The problem

    maximise  l_min(M) - z l_max(M),   M = M0 + sum_i w_i A_i,  A_i = X_i^T X_i,   0 <= w_i <= cap_i,  sum_i w_i = N

is to maximise t - z r with S1 = M - t 1 and S2 = r 1 - M positive semidefinite. With
their duals Y and Z, and a, b those of the limits of w, predictor and corrector steps
follow the path Y S1 = Z S2 = w a = (cap - w) b = mu (Helmberg, Rendl, Vanderbei,
Wolkowicz 1996, SIAM J. Optim. 6, 342-361; Mehrotra 1992, SIAM J. Optim. 2, 575-601).
Each step is one linear system of the size of the active set, with entries
tr(A_i S1^-1 A_j Y) + tr(A_i S2^-1 A_j Z).

S1 is stored as T S1 T^T with T M T^T = 1 at a good plan, so that eigenvalues may spread
over ten decades. S2 is rounded against l_max, which is all it needs. For kappa,
z = l_min / l_max follows the plan (`oed.design.condition`).
"""

import dataclasses
from typing import NamedTuple

import numpy as np
import scipy

from oed.base import Array, Index
from oed.design import relaxation
from oed.design.blocks import block_array, information
from oed.design.forms.protocol import pairwise_traces, weight_gradient

RIDGE = 1e-14  #: of the linear system, which has a unit diagonal


class Move(NamedTuple):
    """A step of all variables, and the shares of it that end at a border."""

    #: changes of the primal variables
    w: Array
    t: float
    r: float
    s1: Array
    s2: Array
    #: changes of the dual variables
    y: Array
    z: Array
    a: Array
    b: Array
    #: shares of the changes at which each kind leaves the feasible set
    primal: float
    dual: float


class Iterate(NamedTuple):
    """Primal w (C,), t, r and dual Y, Z (n, n), a, b (C,) variables."""

    w: Array
    t: float
    r: float
    y: Array
    z: Array
    a: Array
    b: Array

    def after(self, move: Move, primal: float, dual: float) -> "Iterate":
        """The iterate after shares of a move."""
        return Iterate(
            self.w + primal * move.w,
            self.t + primal * move.t,
            self.r + primal * move.r,
            self.y + dual * move.y,
            self.z + dual * move.z,
            self.a + dual * move.a,
            self.b + dual * move.b,
        )


class _SecondOrder(NamedTuple):
    """Second-order terms of a first guess, for the corrector."""

    low: Array
    high: Array
    a: Array
    b: Array


class StepSystem:
    """The system at an iterate: rows for the weights, t and r, bordered by sum dw = 0."""

    def __init__(
        self,
        problem: "InteriorProblem",
        slope: float,
        iterate: Iterate,
        s1: Array,
        s2: Array,
    ) -> None:
        self.problem, self.slope, self.iterate = problem, slope, iterate
        self.s1, self.s2 = s1, s2
        w, y, z = iterate.w, iterate.y, iterate.z
        count = len(w)
        room = problem.caps - w
        self.order = 2 * count + len(y) * (2 if slope else 1)
        half = np.linalg.inv(np.linalg.cholesky(s1))
        self.inverse1 = half.T @ half
        self.inverse2 = np.zeros_like(y)
        turned = _symmetric(y @ problem.square @ self.inverse1)
        h = np.zeros((count + 2, count + 2))
        h[:count, :count] = pairwise_traces(problem.white, self.inverse1, y)
        h[:count, count] = h[count, :count] = -_traces(problem.white, turned)
        h[count, count] = np.sum(turned * problem.square)
        h[count + 1, count + 1] = 1.0
        self.push = weight_gradient(problem.white, half.T) + 1.0 / w - 1.0 / room
        if slope:
            half = np.linalg.inv(np.linalg.cholesky(s2))
            self.inverse2 = half.T @ half
            h[:count, :count] += pairwise_traces(problem.blocks, self.inverse2, z)
            crossed = _symmetric(z @ self.inverse2)
            h[:count, -1] = h[-1, :count] = -_traces(problem.blocks, crossed)
            h[-1, -1] = np.sum(z * self.inverse2)
            self.push -= weight_gradient(problem.blocks, half.T)
        h[np.arange(count), np.arange(count)] += iterate.a / w + iterate.b / room
        self.scale = 1.0 / np.sqrt(np.diag(h))
        scaled = _symmetric(h) * np.outer(self.scale, self.scale)
        scaled[np.diag_indices_from(scaled)] += RIDGE
        self.factor = scipy.linalg.cho_factor(scaled, lower=True)
        self.border = self._solve(np.append(np.ones(count), [0.0, 0.0]))

    def _solve(self, right: Array) -> Array:
        solution = scipy.linalg.cho_solve(self.factor, right * self.scale)
        return np.asarray(solution * self.scale)

    def move(self, target: float, guess: Move | None) -> Move:
        """The step to complementarity `target`, corrected by a first guess."""
        iterate, problem = self.iterate, self.problem
        w = iterate.w
        room = problem.caps - iterate.w
        count = len(iterate.w)
        second = self._second_order(guess)
        x = self._solve(self._right_side(target, second))
        x -= x[:count].sum() / self.border[:count].sum() * self.border
        dw = x[:count]
        dt = float(x[count])
        dr = float(x[-1]) if self.slope else 0.0
        d1 = information(problem.white, dw) - dt * problem.square
        d2 = np.zeros_like(self.inverse1)
        if self.slope:
            d2 = dr * np.eye(len(d2)) - information(problem.blocks, dw)
        dy = target * self.inverse1 - iterate.y
        dy = dy - _symmetric(iterate.y @ d1 @ self.inverse1) - second.low
        dz = target * self.inverse2 - iterate.z
        dz = dz - _symmetric(iterate.z @ d2 @ self.inverse2) - second.high
        da = target / w - iterate.a * (1.0 + dw / w) - second.a
        db = target / room - iterate.b * (1.0 - dw / room) - second.b
        primal = min(_room(self.s1, d1), _reach(w, dw), _reach(room, -dw))
        dual = min(_room(iterate.y, dy), _reach(iterate.a, da), _reach(iterate.b, db))
        if self.slope:
            primal = min(primal, _room(self.s2, d2))
            dual = min(dual, _room(iterate.z, dz))
        return Move(dw, dt, dr, d1, d2, dy, dz, da, db, primal, dual)

    def _second_order(self, guess: Move | None) -> _SecondOrder:
        if guess is None:
            no_matrix, no_vector = (
                np.zeros_like(self.inverse1),
                np.zeros(len(self.iterate.w)),
            )
            return _SecondOrder(no_matrix, no_matrix, no_vector, no_vector)
        w = self.iterate.w
        room = self.problem.caps - self.iterate.w
        return _SecondOrder(
            _symmetric(guess.y @ guess.s1 @ self.inverse1),
            _symmetric(guess.z @ guess.s2 @ self.inverse2),
            guess.a * guess.w / w,
            -guess.b * guess.w / room,
        )

    def _right_side(self, target: float, second: _SecondOrder) -> Array:
        problem = self.problem
        count = len(self.iterate.w)
        right = np.zeros(count + 2)
        right[:count] = (
            target * self.push
            - second.a
            + second.b
            - _traces(problem.white, second.low)
            + _traces(problem.blocks, second.high)
        )
        low_term = np.sum(second.low * problem.square)
        right[count] = 1.0 - target * np.sum(self.inverse1 * problem.square) + low_term
        right[-1] = target * np.trace(self.inverse2) - self.slope
        right[-1] -= np.trace(second.high)
        return right

    def complementarity(self, iterate: Iterate, s1: Array, s2: Array) -> float:
        """Sum of the complementarities of an iterate with its S1 and S2."""
        room = self.problem.caps - iterate.w
        of_matrices = np.sum(iterate.y * s1) + np.sum(iterate.z * s2)
        return float(of_matrices + iterate.a @ iterate.w + iterate.b @ room)


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)


def _traces(blocks: Array, matrix: Array) -> Array:
    """tr(A_i P) (C,)."""
    return np.asarray(np.einsum("ckn,ckn->c", blocks @ matrix, blocks))


def _reach(x: Array, dx: Array) -> float:
    """Share of dx at which a component of x reaches zero."""
    return 1.0 / max(float(np.max(-dx / x)), 1e-30)


def _room(matrix: Array, change: Array) -> float:
    """Share of a change at which a positive definite matrix becomes singular."""
    half = np.linalg.inv(np.linalg.cholesky(matrix))
    least = float(np.linalg.eigvalsh(half @ change @ half.T)[0])
    return 1.0 / max(-least, 1e-30)


STEP_SHARE = 0.95  #: share of a step to the border of the feasible set
MIN_STEP = 1e-8  #: shares of both steps below which the path ends


@dataclasses.dataclass(frozen=True, eq=False)
class InteriorProblem:
    """Candidates, prior information, and a transformation T for good rounding."""

    blocks: Array  #: (C, k, n) X_i
    base: Array  #: (n, n) M0
    size: float  #: N
    caps: Array  #: (C,)
    start: Array  #: (C,) weights of a good plan
    turn: Array  #: T (n, n), with T M T^T = 1 at `start`
    white: Array  #: (C, k, n) X_i T^T
    white_base: Array  #: (n, n) T M0 T^T
    square: Array  #: (n, n) T T^T

    def extreme_eigenvalues(self, active: Index, weights: Array) -> tuple[float, float]:
        """l_min and l_max of M; l_min comes from M^-1, to a rounding of its own."""
        white = self.white_base + information(self.white[active], weights)
        inverse = self.turn.T @ np.linalg.inv(white) @ self.turn
        m = self.base + information(self.blocks[active], weights)
        least = 1.0 / float(np.linalg.eigvalsh(inverse)[-1])
        return least, float(np.linalg.eigvalsh(m)[-1])

    def subset(self, active: Index) -> "InteriorProblem":
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
    blocks = block_array(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    relaxation.check_caps(caps, size, cap)
    base = np.zeros((n, n)) if prior is None else np.asarray(prior, dtype=float)
    start = relaxation.determined_start(blocks, base, size, caps)
    turn = np.linalg.inv(np.linalg.cholesky(base + information(blocks, start)))
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
        self.problem = problem
        self.slope_is_free = slope is None
        caps = problem.caps
        n = len(problem.base)
        even = problem.size * caps / caps.sum()
        w = (1.0 - centre) * weights + centre * even
        least, largest = problem.extreme_eigenvalues(np.arange(len(caps)), w)
        self.slope = max(least / largest, known_slope) if slope is None else slope
        t = (1.0 - centre) * least
        r = 0.0
        inverse = np.linalg.inv(self._low(w, t))
        mu = 1.0 / float(np.sum(inverse * problem.square))
        y: Array = np.asarray(mu * inverse)
        z: Array = np.zeros((n, n))
        if self.slope:
            r = (1.0 + centre) * largest + n * mu / self.slope
            inverse = np.linalg.inv(self._high(w, r))
            mu = max(mu, self.slope / float(np.trace(inverse)))
            z = np.asarray(self.slope * inverse / np.trace(inverse))
        self.iterate = Iterate(w, t, r, y, z, mu / w, mu / (caps - w))

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
        iterate = self.iterate
        try:
            low = self._low(iterate.w, iterate.t)
            high = self._high(iterate.w, iterate.r)
            system = StepSystem(self.problem, self.slope, iterate, low, high)
            now = system.complementarity(iterate, low, high)
            guess = system.move(0.0, None)
            primal, dual = min(1.0, guess.primal), min(1.0, guess.dual)
            after_guess = system.complementarity(
                iterate.after(guess, primal, dual),
                low + primal * guess.s1,
                high + primal * guess.s2,
            )
            mu = now / system.order
            centring = float(np.clip((after_guess / now) ** 2, 1e-3, 1.0))
            move = system.move(centring * mu, guess)
            primal = min(1.0, STEP_SHARE * move.primal)
            dual = min(1.0, STEP_SHARE * move.dual)
            after = iterate.after(move, primal, dual)
            np.linalg.cholesky(after.y)
            if self.slope:
                np.linalg.cholesky(after.z)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            return False
        self.iterate = after
        return max(primal, dual) > MIN_STEP
