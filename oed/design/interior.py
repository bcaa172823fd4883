"""A primal-dual interior point for the extreme eigenvalues of an information matrix.

    maximise  l_min(M) - z l_max(M),   M = M0 + sum_i w_i A_i,  A_i = X_i^T X_i,   0 <= w_i <= cap_i,  sum_i w_i = N

is: maximise t - z r with S1 = M - t 1 and S2 = r 1 - M positive semidefinite. With
their duals Y and Z, and a, b those of the limits of w, the path Y S1 = Z S2 = w a =
(cap - w) b = mu is followed by predictor and corrector steps (Helmberg, Rendl,
Vanderbei, Wolkowicz 1996, SIAM J. Optim. 6, 342-361; Mehrotra 1992, SIAM J. Optim. 2,
575-601), each one linear system of the size of the active set with entries tr(A_i S1^-1
A_j Y) + tr(A_i S2^-1 A_j Z).

S1 is kept as T S1 T^T with T M T^T = 1 at a good plan, so that eigenvalues may spread
over ten decades; S2 is rounded against l_max, which is all it needs. For kappa, z =
l_min / l_max follows the plan (`oed.design.condition`).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.design import relaxation
from oed.design.blocks import as_blocks, information
from oed.design.criterion.protocol import pairs, slopes

#: share of a step to the border
STAY = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class InteriorSetting:
    """Candidates X_i, also as `white` = X_i T^T with T = `turn`, T M T^T = 1 at the
    plan `start`; `square` = T T^T.
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

    def ends(self, active: Index, weights: Array) -> tuple[float, float]:
        """l_min and l_max of M, each to a rounding of its own: the least from M^-1."""
        white = self.white_base + information(self.white[active], weights)
        inverse = self.turn.T @ np.linalg.inv(white) @ self.turn
        m = self.base + information(self.blocks[active], weights)
        return 1.0 / float(np.linalg.eigvalsh(inverse)[-1]), float(
            np.linalg.eigvalsh(m)[-1]
        )

    def take(self, active: Index) -> InteriorSetting:
        """Over some of the candidates."""
        some = {
            name: getattr(self, name)[active]
            for name in ("blocks", "caps", "start", "white")
        }
        return dataclasses.replace(self, **some)


def setting_of(
    rows: Array, size: float, prior: Array | None, cap: Array | float
) -> InteriorSetting:
    blocks = as_blocks(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    if caps.sum() < size * (1 - 1e-12):
        raise ValueError(
            f"{count} candidates of at most {np.max(cap):g} each cannot carry a weight"
            f" of {size:g}"
        )
    base = np.zeros((n, n)) if prior is None else np.asarray(prior, dtype=float)
    try:
        start = caps * (size / caps.sum())
        scale = np.sqrt(np.diag(base + information(blocks, start)))
        np.linalg.cholesky(
            (base + information(blocks, start)) / np.outer(scale, scale)
            - 1e-14 * n * np.eye(n)
        )
        start = relaxation.relax(blocks, size, base, caps, 1e-2).weights
        turn = np.linalg.inv(np.linalg.cholesky(base + information(blocks, start)))
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "candidates and prior leave directions unseen: take the directions that are"
            " seen"
        ) from error
    white, square = blocks @ turn.T, np.asarray(turn @ turn.T)
    return InteriorSetting(
        blocks, base, size, caps, start, turn, white, turn @ base @ turn.T, square
    )


class _Move(NamedTuple):
    """A step: of w, t, r, S1, S2, and of Y, Z, a, b; shares of it that end at a border
    of the former, the latter.
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


class InteriorPath:
    """The state of the method over an active set; y and s1 are in the turned
    coordinates, T^-T Y T^-1 and T S1 T^T.
    """

    def __init__(
        self,
        setting: InteriorSetting,
        slope: float | None,
        weights: Array,
        centre: float,
        known: float = 0.0,
    ) -> None:
        """At `weights` drawn by a share `centre` towards even ones, at the same share's
        distance from l_min.

        Without a slope: at that of the weights, or at the `known` one of a better plan.
        """
        self.setting, self.free = setting, slope is None
        caps, n = setting.caps, len(setting.base)
        self.w = (1.0 - centre) * weights + centre * setting.size * caps / caps.sum()
        least, largest = setting.ends(np.arange(len(caps)), self.w)
        self.slope = max(least / largest, known) if slope is None else slope
        self.t, self.r = (1.0 - centre) * least, 0.0
        inverse = np.linalg.inv(self._low())
        mu = 1.0 / float(np.sum(inverse * setting.square))
        self.y: Array = np.asarray(mu * inverse)
        self.z: Array = np.zeros((n, n))
        if self.slope:
            self.r = (1.0 + centre) * largest + n * mu / self.slope
            inverse = np.linalg.inv(self._high())
            mu = max(mu, self.slope / float(np.trace(inverse)))
            self.z = np.asarray(self.slope * inverse / np.trace(inverse))
        self.a, self.b = mu / self.w, mu / (caps - self.w)

    def _low(self) -> Array:
        s = self.setting
        return np.asarray(
            s.white_base + information(s.white, self.w) - self.t * s.square
        )

    def _high(self) -> Array:
        s = self.setting
        return np.asarray(
            self.r * np.eye(len(s.base)) - s.base - information(s.blocks, self.w)
        )

    def step(self) -> bool:
        """One predictor and corrector; False where rounding ends the path (the state is
        then the last sound one).
        """
        try:
            system = _System(self, self._low(), self._high())
            guess = system.move(0.0, None)
            left = system.gap(
                guess, min(1.0, guess.primal), min(1.0, guess.dual)
            ) / system.gap(None, 0.0, 0.0)
            mu = system.gap(None, 0.0, 0.0) / system.order
            move = system.move(float(np.clip(left**2, 1e-3, 1.0)) * mu, guess)
            primal, dual = min(1.0, STAY * move.primal), min(1.0, STAY * move.dual)
            y, z = self.y + dual * move.y, self.z + dual * move.z
            np.linalg.cholesky(y)
            if self.slope:
                np.linalg.cholesky(z)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            return False
        self.w, self.t, self.r = (
            self.w + primal * move.w,
            self.t + primal * move.t,
            self.r + primal * move.r,
        )
        self.y, self.z, self.a, self.b = (
            y,
            z,
            self.a + dual * move.a,
            self.b + dual * move.b,
        )
        return max(primal, dual) > 1e-8


class _System:
    """The linear system of one step: rows for the weights, t and r, bordered by sum dw
    = 0.
    """

    def __init__(self, path: InteriorPath, s1: Array, s2: Array) -> None:
        self.path, self.s1, self.s2 = path, s1, s2
        s, w, y, z = path.setting, path.w, path.y, path.z
        count, spare = len(w), s.caps - w
        self.order = 2 * count + len(y) * (2 if path.slope else 1)
        half = np.linalg.inv(np.linalg.cholesky(s1))
        self.p, self.q = half.T @ half, np.zeros_like(y)
        turned = _symmetric(y @ s.square @ self.p)
        h = np.zeros((count + 2, count + 2))
        h[:count, :count] = pairs(s.white, self.p, y)
        h[:count, count] = h[count, :count] = -_traces(s.white, turned)
        h[count, count], h[count + 1, count + 1] = np.sum(turned * s.square), 1.0
        self.push = slopes(s.white, half.T) + 1.0 / w - 1.0 / spare
        if path.slope:
            half = np.linalg.inv(np.linalg.cholesky(s2))
            self.q = half.T @ half
            h[:count, :count] += pairs(s.blocks, self.q, z)
            h[:count, -1] = h[-1, :count] = -_traces(s.blocks, _symmetric(z @ self.q))
            h[-1, -1] = np.sum(z * self.q)
            self.push -= slopes(s.blocks, half.T)
        h[np.arange(count), np.arange(count)] += path.a / w + path.b / spare
        self.scale = 1.0 / np.sqrt(np.diag(h))
        self.factor = _factored(_symmetric(h) * np.outer(self.scale, self.scale))
        self.border = self._solve(np.append(np.ones(count), [0.0, 0.0]))

    def _solve(self, right: Array) -> Array:
        return np.asarray(
            linalg.cho_solve(self.factor, right * self.scale) * self.scale
        )

    def move(self, target: float, guess: _Move | None) -> _Move:
        """The step to complementarity `target`, with the second order that a first
        guess shows.
        """
        path, s, p, q = self.path, self.path.setting, self.p, self.q
        w, spare, count = path.w, s.caps - path.w, len(path.w)
        bend1 = bend2 = np.zeros_like(p)
        bend_a = bend_b = np.zeros(count)
        if guess is not None:
            bend1, bend2 = (
                _symmetric(guess.y @ guess.s1 @ p),
                _symmetric(guess.z @ guess.s2 @ q),
            )
            bend_a, bend_b = guess.a * guess.w / w, -guess.b * guess.w / spare
        right = np.zeros(count + 2)
        right[:count] = (
            target * self.push
            - bend_a
            + bend_b
            - _traces(s.white, bend1)
            + _traces(s.blocks, bend2)
        )
        right[count] = 1.0 - target * np.sum(p * s.square) + np.sum(bend1 * s.square)
        right[-1] = target * np.trace(q) - path.slope - np.trace(bend2)
        x = self._solve(right)
        x -= x[:count].sum() / self.border[:count].sum() * self.border
        dw, dt, dr = x[:count], float(x[count]), float(x[-1]) if path.slope else 0.0
        d1 = information(s.white, dw) - dt * s.square
        d2 = (
            dr * np.eye(len(p)) - information(s.blocks, dw)
            if path.slope
            else np.zeros_like(p)
        )
        dy = target * p - path.y - _symmetric(path.y @ d1 @ p) - bend1
        dz = target * q - path.z - _symmetric(path.z @ d2 @ q) - bend2
        da = target / w - path.a * (1.0 + dw / w) - bend_a
        db = target / spare - path.b * (1.0 - dw / spare) - bend_b
        primal = min(_room(self.s1, d1), _reach(w, dw), _reach(spare, -dw))
        dual = min(_room(path.y, dy), _reach(path.a, da), _reach(path.b, db))
        if path.slope:
            primal, dual = min(primal, _room(self.s2, d2)), min(dual, _room(path.z, dz))
        return _Move(dw, dt, dr, d1, d2, dy, dz, da, db, primal, dual)

    def gap(self, move: _Move | None, primal: float, dual: float) -> float:
        """Sum of the complementarities, now or after shares of a move."""
        path, spare = self.path, self.path.setting.caps - self.path.w
        if move is None:
            held = float(np.sum(path.y * self.s1) + path.a @ path.w + path.b @ spare)
            return held + (float(np.sum(path.z * self.s2)) if path.slope else 0.0)
        total = np.sum((path.y + dual * move.y) * (self.s1 + primal * move.s1))
        total += (path.a + dual * move.a) @ (path.w + primal * move.w)
        total += (path.b + dual * move.b) @ (spare - primal * move.w)
        return float(
            total
            + (
                np.sum((path.z + dual * move.z) * (self.s2 + primal * move.s2))
                if path.slope
                else 0.0
            )
        )


def _factored(h: Array) -> tuple[Array, bool]:
    """Cholesky factor of a matrix of unit diagonal, with the least ridge that rounding
    asks for.
    """
    ridge = 1e-14
    while True:
        try:
            factor: tuple[Array, bool] = linalg.cho_factor(
                h + ridge * np.eye(len(h)), lower=True
            )
            return factor
        except np.linalg.LinAlgError:
            ridge *= 10.0
            if ridge > 1e-6:
                raise


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _traces(blocks: Array, matrix: Array) -> Array:
    """tr(A_i P) (C,)."""
    return np.asarray(np.einsum("ckn,ckn->c", blocks @ matrix, blocks))


def _reach(x: Array, dx: Array) -> float:
    """Share of dx at which a component of x reaches zero."""
    return 1.0 / max(float(np.max(-dx / x)), 1e-30)


def _room(matrix: Array, change: Array) -> float:
    """Share of a change at which a positive definite matrix becomes singular."""
    half = np.linalg.inv(np.linalg.cholesky(matrix))
    return 1.0 / max(-float(np.linalg.eigvalsh(half @ change @ half.T)[0]), 1e-30)
