"""One sweep of exchange in continuous coordinates over all points of a design, as one
CasADi call.

A point's block X is taken out of M and put back by Woodbury's formula. With U = X A, A
= M^-1, Z = X C and T = (1 - U X^T)^-1 (taken out) or -(1 + U X^T)^-1 (put in),

    A' = A + U^T T U,
    variance, C = A W A:               C' = C + U^T T Z + Z^T T U + U^T T (Z X^T) T U,
    Ds, C = N (N^T M N)^-1 N^T:        as A, with Z for U.

In between each coordinate takes its best value. See `oed.design.continuous` for the
gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.arrays import Array
from oed.design.smooth import Smooth

#: keeps a point that alone sees a direction from being divided by zero
ALONE = 1e-9
#: least gain of a coordinate's step
STEP_GAIN = 1e-11


class Sweep:
    """Compiled sweep over `size` points for rows v -> X (k, n), within lower and upper
    (d,).

    `between` values are tried for coordinates that X is not affine in: half of them
    anywhere, half near the present one. limits: CasADi function v -> g, values with g >
    slack are not taken.
    """

    def __init__(
        self,
        rows: Any,
        lower: Array,
        upper: Array,
        size: int,
        criterion: Smooth,
        between: int,
        limits: Any | None = None,
        slack: float = 0.0,
    ) -> None:
        self._kind = criterion.name
        self._lower, self._upper = lower, upper
        self._limits, self._slack = limits, slack
        self._rows, (k, n) = rows, rows.size_out(0)
        v = ca.SX.sym("v", len(lower))
        entries = ca.vec(rows(v))
        slopes = ca.jacobian(entries, v)
        self._touched = [slopes[:, j].sparsity().row() for j in range(len(lower))]
        straight = [
            k == 1 and limits is None and ca.jacobian(slopes[:, j], v[j]).nnz() == 0
            for j in range(len(lower))
        ]
        #: whether the ends of every coordinate's range are all that can be best
        self.straight = all(straight)
        self._between = [0 if s else between for s in straight]
        self._draws = max(self._between)
        ways = [
            ca.SX.sym(f"way{i}", n, n) for i in range(1 if self._kind == "D" else 2)
        ]
        t = ca.SX.sym("t", self._draws)
        after, place = self._step(ways, v, t)
        step = ca.Function("step", [*ways, v, t], [*after, place], {"cse": True})
        self._function: Any = step.mapaccum("sweep", size, len(ways))
        buffer: Any
        buffer, self._run = self._function.buffer()
        self._buffer = buffer
        shapes = [(n, n)] * len(ways) + [(size, len(lower)), (size, self._draws)]
        self._inputs = [np.zeros(s) for s in shapes]
        self._output = np.zeros((size, len(lower)))
        for i, array in enumerate(self._inputs):
            if array.size:
                buffer.set_arg(i, memoryview(array.reshape(-1).data))
        buffer.set_res(len(ways), memoryview(self._output.reshape(-1).data))

    def __call__(
        self, inverse: Array, partner: Array, points: Array, rng: np.random.Generator
    ) -> Array:
        """Points (N, d) after one sweep, from M^-1 and the criterion's partner (n, n)
        at the points.
        """
        ways = [inverse] if self._kind == "D" else [inverse, partner]
        levels = self._levels(rng) if self._draws else self._inputs[-1]
        for memory, array in zip(self._inputs, (*ways, points, levels), strict=True):
            memory[:] = array
        self._run()
        return np.clip(self._output, self._lower, self._upper)

    def _levels(self, rng: np.random.Generator) -> Array:
        """Shares of the range: the first half in [0, 1], the rest steps to either side,
        1e-4 to 0.1.
        """
        shape = self._inputs[-1].shape
        far = shape[1] - shape[1] // 2
        steps = 10.0 ** rng.uniform(-4.0, -1.0, (shape[0], shape[1] // 2)) * rng.choice(
            [-1.0, 1.0], shape[1] // 2
        )
        return np.hstack([rng.uniform(size=(shape[0], far)), steps])

    # -- the symbolic step of one point ------------------------------------------------

    def _step(self, ways: Sequence[Any], v: Any, t: Any) -> tuple[list[Any], Any]:
        """M^-1 (and C) and the point after its coordinates took their best values."""
        place, x = v, self._rows(v)
        ways = self._moved(ways, [x @ w for w in ways], x, out=True)
        along = [x @ w for w in ways]
        here = [g @ x.T for g in along]
        for j in range(len(self._lower)):
            best = self._best(ways, along, here, place, x, t, j)
            change = self._change(place, x, best, j)
            here = self._there(ways, along, here, change)
            along = [g + change @ w for w, g in zip(ways, along, strict=True)]
            place, x = _with(place, j, best), x + change
        return self._moved(ways, along, x, out=False), place

    def _moved(
        self, ways: Sequence[Any], along: Sequence[Any], x: Any, *, out: bool
    ) -> list[Any]:
        """M^-1 and partner after X is taken out or put in; `along` are U and Z."""
        u = along[0]
        inner = _inner(u @ x.T, out)
        moved = [_mirrored(ways[0] + u.T @ inner @ u)]
        if self._kind == "Ds":
            z = along[1]
            moved.append(_mirrored(ways[1] + z.T @ _inner(z @ x.T, out) @ z))
        elif self._kind == "variance":
            side = inner @ u
            mixed = side.T @ along[1]
            moved.append(
                _mirrored(ways[1] + mixed + mixed.T + side.T @ (along[1] @ x.T) @ side)
            )
        return moved

    def _best(
        self,
        ways: Sequence[Any],
        along: Sequence[Any],
        here: Sequence[Any],
        place: Any,
        x: Any,
        t: Any,
        j: int,
    ) -> Any:
        """Best value of coordinate j; `along` are X R and X Q, `here` the same times
        X^T.
        """
        best, best_gain = place[j], self._gain(here) + STEP_GAIN
        for value in self._values(place[j], t, j):
            gain = self._gain(
                self._there(ways, along, here, self._change(place, x, value, j))
            )
            better = gain > best_gain
            if self._limits is not None:
                allowed = ca.mmax(self._limits(_with(place, j, value))) <= self._slack
                better = ca.logic_and(better, allowed)
            best, best_gain = (
                ca.if_else(better, value, best),
                ca.if_else(better, gain, best_gain),
            )
        return best

    @staticmethod
    def _there(
        ways: Sequence[Any], along: Sequence[Any], here: Sequence[Any], change: Any
    ) -> list[Any]:
        """X R X^T and X Q X^T after a change of X."""
        there = []
        for w, g, s in zip(ways, along, here, strict=True):
            cross = change @ g.T
            there.append(s + cross + cross.T + (change @ w) @ change.T)
        return there

    def _values(self, now: Any, t: Any, j: int) -> list[Any]:
        lower, upper = float(self._lower[j]), float(self._upper[j])
        far = self._draws - self._draws // 2
        values: list[Any] = [ca.SX(lower), ca.SX(upper)]
        for i in range(self._between[j]):
            wish = (
                lower + t[i] * (upper - lower)
                if i < far
                else now + t[i] * (upper - lower)
            )
            values.append(ca.fmin(ca.fmax(wish, lower), upper))
        return values

    def _change(self, place: Any, x: Any, value: Any, j: int) -> Any:
        """How X changes (sparse) when coordinate j takes a value: only entries that
        hold it.
        """
        moved, change = ca.vec(self._rows(_with(place, j, value))), ca.SX(*x.shape)
        for e in self._touched[j]:
            r, column = e % x.shape[0], e // x.shape[0]
            change[r, column] = moved[e] - x[r, column]
        return change

    def _gain(self, s: Sequence[Any]) -> Any:
        k = s[0].shape[0]
        one = ca.SX.eye(k)
        if self._kind == "variance":
            return (
                ca.trace(ca.solve(one + s[0], s[1])) if k > 1 else s[1] / (1.0 + s[0])
            )
        gain = _log_det(one + s[0])
        return gain - _log_det(one + s[1]) if self._kind == "Ds" else gain


def _with(place: Any, j: int, value: Any) -> Any:
    return ca.vertcat(*[value if i == j else place[i] for i in range(place.numel())])


def _inner(s: Any, out: bool) -> Any:
    """T: (1 - S)^-1 of a block taken out, -(1 + S)^-1 of one put in."""
    one = ca.SX.eye(s.shape[0])
    if s.shape[0] == 1:
        return 1.0 / ca.fmax(1.0 - s, ALONE) if out else -1.0 / (1.0 + s)
    return ca.solve((1.0 + ALONE) * one - s, one) if out else -ca.solve(one + s, one)


def _mirrored(m: Any) -> Any:
    """A symmetric matrix from its lower triangle: half the work."""
    return ca.tril2symm(ca.tril(m))


def _log_det(m: Any) -> Any:
    if m.shape[0] == 1:
        return ca.log(m)
    return 2.0 * ca.sum1(ca.log(ca.diag(ca.chol((m + m.T) / 2.0))))
