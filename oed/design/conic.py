"""Optimal weights by a general conic solver, under any linear limits on the weights.

    maximise  log phi(M0 + sum_i w_i A_i)   over  0 <= w_i <= cap_i,  sum_i w_i = N,  L w <= l.

It serves plans with quotas (`oed.design.quotas`), and as an independent check of
`oed.design.relaxation` and `oed.design.condition`, which are far quicker where they
apply. The criteria enter as cones (`oed.design.conic_criterion`).

Only a plan and dual matrices are taken from the solver's answer. The plan is made
feasible. A dual gives a line above the criterion (`oed.design.forms.protocol`),
whose extreme over the weights (`oed.design.polytope`) holds whatever the solver
reports.
"""

from __future__ import annotations

import warnings
from typing import Any, Literal

import cvxpy as cp
import numpy as np

from oed.base import Array
from oed.design import relaxation
from oed.design.blocks import as_blocks, information
from oed.design.certificate import ROUNDING
from oed.design.conic_criterion import ConicCriterion, dual_root
from oed.design.forms import Compound, Criterion, ExtremeEigenvalues
from oed.design.forms.protocol import Support, slopes
from oed.design.polytope import Polytope
from oed.design.relaxation import Relaxation

Solver = Literal["CLARABEL", "SCS"]


class NoConicAnswerError(ValueError):
    """The conic solver ended without an answer; the text says what to use instead."""


#: duality gap of the relaxation whose information scales the problem
SCALING_TOLERANCE = 1e-2
#: relative accuracy of the least ratio of kappa, and steps towards it
RATIO_TOLERANCE, RATIO_STEPS = 1e-10, 30


def relax(
    rows: Array,
    size: float,
    criterion: Criterion,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    limits: tuple[Array, Array] | None = None,
    solver: Solver = "CLARABEL",
) -> Relaxation:
    """Optimal weights of candidates (C, n) or (C, k, n), value and bound as log phi.

    limits are (L, C) rows and (L,) upper: rows w <= upper. For kappa and O2 log phi is
    -log kappa. Raises ValueError where no weights keep size, caps and limits, where
    candidates and prior leave directions undetermined, or for a criterion that has no
    conic form here.
    """
    blocks = as_blocks(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    limit_rows, upper = limits or (np.zeros((0, count)), np.zeros(0))
    feasible = Polytope(size, caps, limit_rows, upper)
    base = np.zeros((n, n)) if prior is None else np.asarray(prior, dtype=float)
    problem = _ConicProblem(blocks, base, feasible, _typical(blocks, base, size, cap))
    if isinstance(criterion, ExtremeEigenvalues) and not criterion.concave:
        return _relax_condition(problem, criterion, solver)
    return _relax_concave(problem, criterion, solver)


def _typical(blocks: Array, base: Array, size: float, cap: Array | float) -> Array:
    """Information (n, n) of a good plan without limits."""
    try:
        start = relaxation.relax(blocks, size, base, cap, SCALING_TOLERANCE)
        typical = base + information(blocks, start.weights)
        np.linalg.cholesky(typical)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            "candidates and prior leave directions undetermined: restrict the problem"
            " to the estimable subspace"
        ) from error
    return typical


class _ConicProblem:
    """Candidates and feasible weights as cvxpy expressions.

    typical  (n, n) information of a good plan
    turn     T (n, n) with T M T^T = 1 there: entries near one for the solver
    """

    def __init__(
        self, blocks: Array, base: Array, feasible: Polytope, typical: Array
    ) -> None:
        self.blocks, self.base, self.feasible = blocks, base, feasible
        self.typical = typical
        self.turn: Array = np.linalg.inv(np.linalg.cholesky(typical))

    def weights(self) -> Any:
        """The variable of the weights."""
        return cp.Variable(len(self.blocks), nonneg=True)

    def matrix(self, weights: Any, turn: Array, scale: Any = 1.0) -> Any:
        """T (scale M0 + sum w_i A_i) T^T."""
        white = self.blocks @ turn.T
        products = np.einsum("ckn,ckm->cnm", white, white)
        columns = products.reshape(len(self.blocks), -1).T
        total = cp.reshape(columns @ weights, self.base.shape, order="C")
        m = scale * (turn @ self.base @ turn.T) + total
        return 0.5 * (m + m.T)

    def limits(self, weights: Any, scale: Any = 1.0) -> list[Any]:
        """Constraints that make weights / scale feasible."""
        feasible = self.feasible
        constraints = [
            cp.sum(weights) == feasible.size * scale,
            weights <= feasible.caps * scale,
        ]
        if len(feasible.upper):
            constraints.append(feasible.rows @ weights <= feasible.upper * scale)
        return constraints

    def information(self, weights: Array) -> Array:
        """M (n, n)."""
        return self.base + information(self.blocks, weights)

    def base_term(self, root: Array) -> float:
        """<R R^T, M0>."""
        return float(np.sum((self.base @ root) * root))


def _relax_concave(
    problem: _ConicProblem, criterion: Criterion, solver: Solver
) -> Relaxation:
    variable = problem.weights()
    m = problem.matrix(variable, problem.turn)
    parts: tuple[Criterion, ...] = (criterion,)
    shares: tuple[float, ...] = (1.0,)
    if isinstance(criterion, Compound):
        parts, shares = criterion.parts, criterion.shares
    terms = [ConicCriterion(c, m, problem.turn, problem.typical) for c in parts]
    pairs = list(zip(shares, terms, strict=True))
    goal = cp.Maximize(sum(share * term.log for share, term in pairs))
    constraints = problem.limits(variable)
    for term in terms:
        constraints += term.constraints
    _solve(goal, constraints, solver)
    weights = _feasible_weights(problem, variable.value)
    m_at_weights = problem.information(weights)
    supports = [(share, term.support(m_at_weights)) for share, term in pairs]
    offset, root = _join(supports, m_at_weights)
    line_slopes = slopes(problem.blocks, root)
    carried = problem.feasible.maximise(line_slopes)[0] + problem.base_term(root)
    # the line is one of the least eigenvalue, of which E or O3 is a power
    power = criterion.least if isinstance(criterion, ExtremeEigenvalues) else 1.0
    bound = float(power * (offset + np.log(carried)) + ROUNDING)
    value = criterion.value(m_at_weights)
    return Relaxation(weights, value, bound, power * line_slopes)


def _feasible_weights(problem: _ConicProblem, weights: Array | None) -> Array:
    """The solver's weights, or even ones without an answer, made feasible."""
    if weights is None:
        caps = problem.feasible.caps
        weights = caps * (problem.feasible.size / caps.sum())
    return problem.feasible.nearest(np.asarray(weights))


def _join(supports: list[tuple[float, Support]], m: Array) -> tuple[float, Array]:
    """Offset and root of one line above a weighted sum of criteria."""
    offset, roots = 0.0, []
    for share, support in supports:
        size = float(np.sum((m @ support.root) * support.root))
        offset += share * (support.value + np.log(size))
        roots.append(np.sqrt(share / size) * support.root)
    return float(offset), np.hstack(roots)


def _relax_condition(
    problem: _ConicProblem, criterion: ExtremeEigenvalues, solver: Solver
) -> Relaxation:
    """Least condition number, as a ratio made linear by w = u / tau.

    Minimises s subject to 1 <= tau M0 + sum u_i A_i <= s 1, up to scales.
    """
    if criterion.least != criterion.largest:
        raise NoConicAnswerError(
            f"{criterion.name} has no conic form: see oed.design.condition"
        )
    tau, s = cp.Variable(nonneg=True), cp.Variable()
    identity = np.eye(len(problem.base))
    eigenvalues = np.linalg.eigvalsh(problem.typical)
    u, turn = problem.weights(), problem.turn
    white = problem.matrix(u, turn, tau)
    plain = problem.matrix(u, identity, tau)
    lower = white >> eigenvalues[0] * turn @ turn.T
    upper = plain / eigenvalues[-1] << s * identity
    _solve(cp.Minimize(s), [*problem.limits(u, tau), lower, upper], solver)
    if u.value is None or lower.dual_value is None or not tau.value > 0:
        raise NoConicAnswerError(
            "the conic solver did not find a condition number: use oed.design.condition"
        )
    weights = problem.feasible.nearest(np.asarray(u.value) / float(tau.value))
    y = dual_root(turn.T @ lower.dual_value @ turn)
    z = dual_root(upper.dual_value)
    low, high = slopes(problem.blocks, y), slopes(problem.blocks, z)
    base_low, base_high = problem.base_term(y), problem.base_term(z)
    value = criterion.value(problem.information(weights))
    start = float(np.exp(-value / criterion.least))
    ratio = _least_ratio(problem.feasible, (base_low, low), (base_high, high), start)
    by_low = low / (base_low + low @ weights)
    by_high = high / (base_high + high @ weights)
    bound = float(-criterion.least * np.log(max(ratio, 1e-300)) + ROUNDING)
    return Relaxation(weights, value, bound, criterion.least * (by_low - by_high))


def _least_ratio(
    feasible: Polytope,
    low: tuple[float, Array],
    high: tuple[float, Array],
    ratio: float,
) -> float:
    """A lower bound of <Z, M> / <Y, M> over the feasible weights.

    Dinkelbach's steps lead down from the `ratio` of a plan. low and high hold the
    products of Y and of Z with M0, and with each candidate.
    """
    (base_low, low_slopes), (base_high, high_slopes) = low, high
    for k in range(RATIO_STEPS):
        excess, at = feasible.maximise(ratio * low_slopes - high_slopes)
        if ratio * base_low - base_high + excess <= RATIO_TOLERANCE * ratio:
            return ratio
        numerator = base_high + high_slopes @ at
        lower_step = ratio * (1 - RATIO_TOLERANCE * 2.0**k)
        ratio_here = float(numerator / (base_low + low_slopes @ at))
        ratio = min(ratio_here, lower_step)
    return 0.0


def _solve(goal: Any, constraints: list[Any], solver: Solver) -> None:
    with warnings.catch_warnings():
        # an inexact answer only loosens the bound, which shows in the duality gap
        warnings.simplefilter("ignore")
        try:
            cp.Problem(goal, constraints).solve(solver=solver)
        except cp.SolverError:
            return
