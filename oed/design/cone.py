"""Optimal weights by a general conic solver: slow, for nearly any criterion and any
linear limits on the weights.

    maximise  log phi(M0 + sum_i w_i A_i)   over  0 <= w_i <= cap_i,  sum_i w_i = N,  L w <= l.

Where `oed.design.relaxation` and `oed.design.condition` apply they are far quicker;
this is the case with budgets or group limits of any kind, and an opinion independent of
theirs. Criteria enter by their hypographs (Ben-Tal and Nemirovski 2001, Lectures on
Modern Convex Optimization, chapter 4), y standing for phi:

    D        log det M                            Ds     log det C,  M >= K C K^T
    A, c, I  tr(F (y^2 M^-1) F^T) <= y            G      the same for each W_j
    E        M >= y 1                             kappa  min s,  1 <= tau M0 + sum u_i A_i <= s 1,  w = u / tau
    phi_p    U_1 >= y^2 M^-1,  U_(k+1) >= U_k^2 / y,  |U_k| <= sqrt(n) y  for p = 2^k;   p = 1/2:  V^2 <= M,
             q tr V^-1 <= n,  y = q^2

and compound criteria by the weighted sum of their logarithms. Of the solver's answer
only a plan and dual matrices are taken: the plan is made feasible, and a dual gives a
line above the criterion (`oed.design.criterion.protocol`) whose extreme over the
weights (`oed.design.polytope`) holds whatever the solver said.
"""

from __future__ import annotations

import warnings
from typing import Any, Literal

import cvxpy as cp
import numpy as np

from oed.arrays import Array
from oed.design import relaxation
from oed.design.blocks import as_blocks, information
from oed.design.certificate import SAFE
from oed.design.criterion import (
    Compound,
    Criterion,
    Determinant,
    Power,
    Spectrum,
    Support,
    Variance,
    Worst,
)
from oed.design.criterion.protocol import slopes
from oed.design.polytope import Polytope
from oed.design.relaxation import Relaxed


def relax(
    rows: Array,
    size: float,
    criterion: Criterion,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    limits: tuple[Array, Array] | None = None,
    solver: Literal["CLARABEL", "SCS"] = "CLARABEL",
) -> Relaxed:
    """Weights of candidates (C, n) or (C, k, n), with limits (L, C) w <= (L,); value
    and bound as log phi.

    For kappa and O2, log phi = -log kappa. Raises ValueError where no weights keep
    size, caps and limits, where candidates and prior leave directions unseen, or for a
    criterion that has no conic form here.
    """
    blocks = as_blocks(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    plans = Polytope(size, caps, limits or (np.zeros((0, count)), np.zeros(0)))
    base = np.zeros((n, n)) if prior is None else np.asarray(prior, dtype=float)
    try:
        like = base + information(
            blocks, relaxation.relax(blocks, size, base, cap, 1e-2).weights
        )
        turn = np.linalg.inv(
            np.linalg.cholesky(like)
        )  # T M T^T = 1 at this plan: entries near one for the solver
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "candidates and prior leave directions unseen: take the directions that are"
            " seen"
        ) from error
    if isinstance(criterion, Spectrum) and not criterion.concave:
        return _kappa(blocks, base, criterion, plans, like, turn, solver)
    w, m = _matrix(blocks, base, turn)
    parts, shares = (
        (criterion.parts, criterion.shares)
        if isinstance(criterion, Compound)
        else ((criterion,), (1.0,))
    )
    terms = [_Term(c, m, turn, like) for c in parts]
    goal = cp.Maximize(sum(a * t.log for a, t in zip(shares, terms, strict=True)))
    _solve(goal, [*_rules(plans, w), *(r for t in terms for r in t.rules)], solver)
    weights = plans.nearest(
        caps * (size / caps.sum()) if w.value is None else np.asarray(w.value)
    )
    m = base + information(blocks, weights)
    lines = [(a, t.support(m)) for a, t in zip(shares, terms, strict=True)]
    sizes = [float(np.sum((m @ s.root) * s.root)) for _, s in lines]
    root = np.hstack(
        [np.sqrt(a / z) * s.root for (a, s), z in zip(lines, sizes, strict=True)]
    )
    above = sum(
        a * (s.value + np.log(z)) for (a, s), z in zip(lines, sizes, strict=True)
    )
    gains = slopes(blocks, root)
    most = plans.most(gains)[0] + float(np.sum((base @ root) * root))
    power = criterion.least if isinstance(criterion, Spectrum) else 1.0
    return Relaxed(
        weights,
        criterion.value(m),
        float(power * (above + np.log(most)) + SAFE),
        power * gains,
    )


def _kappa(
    blocks: Array,
    base: Array,
    criterion: Spectrum,
    plans: Polytope,
    like: Array,
    turn: Array,
    solver: str,
) -> Relaxed:
    """Least condition number; its bound as in `oed.design.condition`."""
    if criterion.least != criterion.largest:
        raise ValueError(
            f"{criterion.name} has no conic form: see oed.design.condition"
        )
    tau, s = cp.Variable(nonneg=True), cp.Variable()
    values = np.linalg.eigvalsh(like)
    u, white = _matrix(blocks, base, turn, tau)
    _, plain = _matrix(blocks, base, np.eye(len(base)), tau, u)
    low, high = (
        white >> values[0] * turn @ turn.T,
        plain / values[-1] << s * np.eye(len(base)),
    )
    _solve(cp.Minimize(s), [*_rules(plans, u, tau), low, high], solver)
    if u.value is None or low.dual_value is None or not tau.value > 0:
        raise ValueError(
            "the conic solver found no condition number: see oed.design.condition"
        )
    weights = plans.nearest(np.asarray(u.value) / float(tau.value))
    y, z = _root(turn.T @ low.dual_value @ turn), _root(high.dual_value)
    rise, growth = slopes(blocks, y), slopes(blocks, z)
    held = float(np.sum((base @ y) * y)), float(np.sum((base @ z) * z))
    value = criterion.value(base + information(blocks, weights))
    ratio = np.exp(
        -value / criterion.least
    )  # least <Z, M> / <Y, M>, by Dinkelbach's steps down from a plan's
    for k in range(30):
        over, at = plans.most(ratio * rise - growth)
        if ratio * held[0] - held[1] + over <= 1e-10 * ratio:
            break
        ratio = min(
            (held[1] + growth @ at) / (held[0] + rise @ at),
            ratio * (1 - 1e-10 * 2.0**k),
        )
    else:
        ratio = 0.0
    gains = criterion.least * (
        rise / (held[0] + rise @ weights) - growth / (held[1] + growth @ weights)
    )
    return Relaxed(
        weights,
        value,
        float(-criterion.least * np.log(max(ratio, 1e-300)) + SAFE),
        gains,
    )


class _Term:
    """log phi of one criterion, up to a constant, as a cvxpy expression of T M T^T; and
    the line its dual tells.
    """

    def __init__(self, criterion: Criterion, m: Any, turn: Array, like: Array) -> None:
        self.criterion, self.turn, self.y, n = (
            criterion,
            turn,
            cp.Variable(nonneg=True),
            len(turn),
        )
        unit = float(
            np.exp(criterion.value(like))
        )  # y is told in units of phi at a good plan
        self.log: Any = cp.log(self.y)
        if isinstance(criterion, Determinant) and criterion.interest is None:
            self.rules, self.log = [], cp.log_det(m) / n
        elif isinstance(criterion, Determinant):
            assert criterion.interest is not None
            k, c = (
                np.linalg.qr(turn @ criterion.interest)[0],
                cp.Variable((criterion.size,) * 2, symmetric=True),
            )
            self.rules, self.log = [m >> k @ c @ k.T], cp.log_det(c) / criterion.size
        elif isinstance(criterion, Variance | Worst):
            factors = (
                criterion.factors
                if isinstance(criterion, Worst)
                else criterion.factor[None]
            )
            self.rules = [
                cp.matrix_frac(np.sqrt(unit) * turn @ f.T * self.y, m) <= self.y
                for f in factors
            ]
        elif isinstance(criterion, Spectrum) and criterion.concave:
            low = unit ** (1.0 / criterion.least)
            self.rules = [m >> self.y * (low * turn @ turn.T)]
        elif isinstance(criterion, Power) and (
            criterion.p == 0.5 or float(np.log2(criterion.p)).is_integer()
        ):
            self.rules = self._power(criterion.p, m, np.sqrt(unit) * turn)
        else:
            raise ValueError(
                f"{criterion.name} has no conic form here (phi_p: p = 1/2, 1, 2, 4, 8,"
                " ...)"
            )

    def _power(self, p: float, m: Any, turn: Array) -> list[Any]:
        n, y = len(turn), self.y
        u = cp.Variable((n, n), symmetric=True)
        if p == 0.5:
            self.log = 2.0 * cp.log(y)
            return [
                _above(np.eye(n), turn @ u, m),
                cp.matrix_frac(np.eye(n) * y, u) <= n * y,
            ]
        if p == 1.0:
            return [cp.matrix_frac(turn * y / np.sqrt(n), m) <= y]
        rules = [_above(u, turn * y, m)]
        for _ in range(int(np.log2(p)) - 1):
            u, last = cp.Variable((n, n), symmetric=True), u
            rules.append(_above(u, last, y * np.eye(n)))
        return [*rules, cp.norm(u, "fro") <= np.sqrt(n) * y]

    def support(self, m: Array) -> Support:
        """A line above log phi (E: log l_min) near M; where phi has kinks, the solver's
        dual tells which.
        """
        told = [r.dual_value for r in self.rules]
        if isinstance(self.criterion, Spectrum):
            return Support(
                0.0,
                (
                    np.linalg.eigh(m)[1][:, :1]
                    if told[0] is None
                    else _root(self.turn.T @ told[0] @ self.turn)
                ),
            )
        if isinstance(self.criterion, Worst) and told[0] is not None:
            shares = np.maximum(np.array(told, dtype=float).reshape(-1), 1e-12)
            mean = (
                self.criterion.factors * np.sqrt(shares / shares.sum())[:, None, None]
            )
            return Variance(mean.reshape(-1, len(m))).support(m)
        return self.criterion.support(m)


def _matrix(
    blocks: Array, base: Array, turn: Array, tau: Any = 1.0, w: Any = None
) -> tuple[Any, Any]:
    """Weights, and T (tau M0 + sum w_i A_i) T^T, as cvxpy variable and expression."""
    white = blocks @ turn.T
    products = np.einsum("ckn,ckm->cnm", white, white).reshape(len(blocks), -1)
    w = cp.Variable(len(blocks), nonneg=True) if w is None else w
    m = tau * (turn @ base @ turn.T) + cp.reshape(products.T @ w, base.shape, order="C")
    return w, 0.5 * (m + m.T)


def _rules(plans: Polytope, w: Any, tau: Any = 1.0) -> list[Any]:
    """That w / tau are weights allowed."""
    rows, most = plans.limits
    return [cp.sum(w) == plans.size * tau, w <= plans.caps * tau] + (
        [rows @ w <= most * tau] if len(most) else []
    )


def _above(corner: Any, side: Any, other: Any) -> Any:
    """corner >= side^T other^-1 side, by Schur's complement."""
    return cp.bmat([[corner, side.T], [side, other]]) >> 0


def _solve(goal: Any, rules: list[Any], solver: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # an inexact answer only loosens the bound, which shows in the gap
        try:
            cp.Problem(goal, rules).solve(solver=solver)
        except cp.SolverError:
            return


def _root(dual: Array) -> Array:
    """R (n, n) with R R^T = the dual repaired: symmetric, positive semidefinite, trace
    1.
    """
    values, vectors = np.linalg.eigh(0.5 * (dual + dual.T))
    values = np.maximum(values, 0.0)
    return np.asarray(vectors * np.sqrt(values / values.sum()))
