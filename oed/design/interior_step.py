"""One linear system of the interior-point method, and its predictor and corrector moves.

Symbols are those of `oed.design.interior`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg

from oed.base import Array
from oed.design.blocks import information
from oed.design.forms.protocol import pairwise_traces, slopes

if TYPE_CHECKING:
    from oed.design.interior import InteriorProblem

#: least and largest ridge of the linear system
LEAST_RIDGE, LARGEST_RIDGE = 1e-14, 1e-6


class Move(NamedTuple):
    """A step of all variables, and the shares of it that end at a border.

    w, t, r, s1, s2  changes of the primal variables
    y, z, a, b       changes of the dual variables
    primal, dual     shares of the changes at which each kind leaves the feasible set
    """

    w: Array
    t: float
    r: float
    s1: Array
    s2: Array
    y: Array
    z: Array
    a: Array
    b: Array
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

    def after(self, move: Move, primal: float, dual: float) -> Iterate:
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
        self, problem: InteriorProblem, slope: float, at: Iterate, s1: Array, s2: Array
    ) -> None:
        self.problem, self.slope, self.at = problem, slope, at
        self.s1, self.s2 = s1, s2
        w, y, z = at.w, at.y, at.z
        count, room = len(w), problem.caps - w
        self.order = 2 * count + len(y) * (2 if slope else 1)
        half = np.linalg.inv(np.linalg.cholesky(s1))
        self.inverse1, self.inverse2 = half.T @ half, np.zeros_like(y)
        turned = _symmetric(y @ problem.square @ self.inverse1)
        h = np.zeros((count + 2, count + 2))
        h[:count, :count] = pairwise_traces(problem.white, self.inverse1, y)
        h[:count, count] = h[count, :count] = -_traces(problem.white, turned)
        h[count, count] = np.sum(turned * problem.square)
        h[count + 1, count + 1] = 1.0
        self.push = slopes(problem.white, half.T) + 1.0 / w - 1.0 / room
        if slope:
            half = np.linalg.inv(np.linalg.cholesky(s2))
            self.inverse2 = half.T @ half
            h[:count, :count] += pairwise_traces(problem.blocks, self.inverse2, z)
            crossed = _symmetric(z @ self.inverse2)
            h[:count, -1] = h[-1, :count] = -_traces(problem.blocks, crossed)
            h[-1, -1] = np.sum(z * self.inverse2)
            self.push -= slopes(problem.blocks, half.T)
        h[np.arange(count), np.arange(count)] += at.a / w + at.b / room
        self.scale = 1.0 / np.sqrt(np.diag(h))
        scaled = _symmetric(h) * np.outer(self.scale, self.scale)
        self.factor = _factorise(scaled)
        self.border = self._solve(np.append(np.ones(count), [0.0, 0.0]))

    def _solve(self, right: Array) -> Array:
        solution = linalg.cho_solve(self.factor, right * self.scale)
        return np.asarray(solution * self.scale)

    def move(self, target: float, guess: Move | None) -> Move:
        """The step to complementarity `target`, corrected by a first guess."""
        at, problem = self.at, self.problem
        w, room, count = at.w, problem.caps - at.w, len(at.w)
        second = self._second_order(guess)
        x = self._solve(self._right_side(target, second))
        x -= x[:count].sum() / self.border[:count].sum() * self.border
        dw, dt = x[:count], float(x[count])
        dr = float(x[-1]) if self.slope else 0.0
        d1 = information(problem.white, dw) - dt * problem.square
        d2 = np.zeros_like(self.inverse1)
        if self.slope:
            d2 = dr * np.eye(len(d2)) - information(problem.blocks, dw)
        dy = target * self.inverse1 - at.y
        dy = dy - _symmetric(at.y @ d1 @ self.inverse1) - second.low
        dz = target * self.inverse2 - at.z
        dz = dz - _symmetric(at.z @ d2 @ self.inverse2) - second.high
        da = target / w - at.a * (1.0 + dw / w) - second.a
        db = target / room - at.b * (1.0 - dw / room) - second.b
        primal = min(_room(self.s1, d1), _reach(w, dw), _reach(room, -dw))
        dual = min(_room(at.y, dy), _reach(at.a, da), _reach(at.b, db))
        if self.slope:
            primal = min(primal, _room(self.s2, d2))
            dual = min(dual, _room(at.z, dz))
        return Move(dw, dt, dr, d1, d2, dy, dz, da, db, primal, dual)

    def _second_order(self, guess: Move | None) -> _SecondOrder:
        if guess is None:
            no_matrix, no_vector = (
                np.zeros_like(self.inverse1),
                np.zeros(len(self.at.w)),
            )
            return _SecondOrder(no_matrix, no_matrix, no_vector, no_vector)
        w, room = self.at.w, self.problem.caps - self.at.w
        return _SecondOrder(
            _symmetric(guess.y @ guess.s1 @ self.inverse1),
            _symmetric(guess.z @ guess.s2 @ self.inverse2),
            guess.a * guess.w / w,
            -guess.b * guess.w / room,
        )

    def _right_side(self, target: float, second: _SecondOrder) -> Array:
        problem, count = self.problem, len(self.at.w)
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

    def complementarity(self, move: Move | None, primal: float, dual: float) -> float:
        """Sum of the complementarities, now or after shares of a move."""
        at, room = self.at, self.problem.caps - self.at.w
        if move is None:
            total = float(np.sum(at.y * self.s1) + at.a @ at.w + at.b @ room)
            return total + (float(np.sum(at.z * self.s2)) if self.slope else 0.0)
        after = at.after(move, primal, dual)
        total = float(np.sum(after.y * (self.s1 + primal * move.s1)))
        total += float(after.a @ after.w)
        total += float(after.b @ (room - primal * move.w))
        if self.slope:
            total += float(np.sum(after.z * (self.s2 + primal * move.s2)))
        return total


def _factorise(h: Array) -> tuple[Array, bool]:
    """Cholesky factor of a matrix of unit diagonal, with the least ridge it needs."""
    ridge = LEAST_RIDGE
    while True:
        try:
            ridged = h + ridge * np.eye(len(h))
            factor: tuple[Array, bool] = linalg.cho_factor(ridged, lower=True)
            return factor
        except np.linalg.LinAlgError:
            ridge *= 10.0
            if ridge > LARGEST_RIDGE:
                raise


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
