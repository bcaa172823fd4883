"""Optimal weights by a general conic solver, under any linear limits on the weights.

    maximise  log phi(M0 + sum_i w_i A_i)   over  0 <= w_i <= cap_i,  sum_i w_i = N,  L w <= l.

It serves plans with quotas (`oed.design.quotas`), and as an independent check of
`oed.design.relaxation` and `oed.design.condition`, which are far quicker where they
apply.

Only a plan and dual matrices are taken from the solver's answer. The plan is made
feasible. A dual gives a line above the criterion (`oed.design.forms.protocol`),
whose extreme over the weights holds whatever the solver reports.

The criteria enter by their hypographs (Ben-Tal and Nemirovski 2001, Lectures on Modern
Convex Optimization, chapter 4), with y for phi:

    D        log det M
    Ds       log det C,  M >= K C K^T
    A, c, I  tr(F (y^2 M^-1) F^T) <= y
    G        the same for each W_j
    E        M >= y 1
    phi_p    U_1 >= y^2 M^-1,  U_(k+1) >= U_k^2 / y,  |U_k| <= sqrt(n) y  for p = 2^k
    p = 1/2  V^2 <= M,  q tr V^-1 <= n,  y = q^2

For any prices p >= 0 of
the limits L w <= l, g^T w <= p^T l + (g - L^T p)^T w. The right side is largest for candidates
filled to their caps, which bounds what gradient g can carry. A linear solver gives good
prices; the bound holds for any.
"""

import dataclasses
import warnings
from typing import Any, Literal

import cvxpy as cp
import numpy as np
from scipy import optimize, sparse

from oed.base import Array
from oed.design import relaxation
from oed.design.blocks import block_array, information
from oed.design.forms import (
    Compound,
    Criterion,
    Determinant,
    ExtremeEigenvalues,
    LargestVariance,
    PowerMean,
    Variance,
)
from oed.design.forms.compound import join_supports
from oed.design.forms.protocol import Support, weight_gradient
from oed.design.objective import LOG_ROUNDING, knapsack_value, knapsack_weights
from oed.design.relaxation import Relaxation

MIN_SHARE = 1e-12  #: least share of a place in the mean variance that bounds G


class ConicCriterion:
    """log phi of one criterion, up to a constant, as a cvxpy expression of T M T^T.

    log          the expression to maximise
    constraints  that define it
    """

    def __init__(
        self, criterion: Criterion, m: Any, turn: Array, typical: Array
    ) -> None:
        """m is T M T^T for `turn` T (n, n); phi is in units of its `typical` value.

        Raises ValueError for a criterion that has no conic form here.
        """
        self.criterion, self.turn = criterion, turn
        unit = float(np.exp(criterion.value(typical)))
        self.y = cp.Variable(nonneg=True)
        self.log: Any = cp.log(self.y)
        self.constraints: list[Any] = self._formulate(criterion, m, unit)

    def _formulate(self, criterion: Criterion, m: Any, unit: float) -> list[Any]:
        if isinstance(criterion, Determinant):
            return self._determinant(criterion, m)
        if isinstance(criterion, Variance):
            return self._variances(criterion.factor[None], m, unit)
        if isinstance(criterion, LargestVariance):
            return self._variances(criterion.factors, m, unit)
        if isinstance(criterion, ExtremeEigenvalues) and criterion.concave:
            low = unit ** (1.0 / criterion.least)
            return [m >> self.y * (low * self.turn @ self.turn.T)]
        if isinstance(criterion, PowerMean):
            p = criterion.p
            if p == 0.5 or float(np.log2(p)).is_integer():
                return self._power_mean(p, m, np.sqrt(unit) * self.turn)
        raise ValueError(
            f"{criterion.name} has no conic form here (phi_p: p = 1/2, 1, 2, 4, 8, ...)"
        )

    def _determinant(self, criterion: Determinant, m: Any) -> list[Any]:
        if criterion.interest is None:
            self.log = cp.log_det(m) / len(self.turn)
            return []
        k = np.linalg.qr(self.turn @ criterion.interest)[0]
        c = cp.Variable((criterion.size, criterion.size), symmetric=True)
        self.log = cp.log_det(c) / criterion.size
        return [m >> k @ c @ k.T]

    def _variances(self, factors: Array, m: Any, unit: float) -> list[Any]:
        scaled = np.sqrt(unit) * self.turn
        return [cp.matrix_frac(scaled @ f.T * self.y, m) <= self.y for f in factors]

    def _power_mean(self, p: float, m: Any, turn: Array) -> list[Any]:
        n = len(turn)
        y = self.y
        if p == 1.0:
            return [cp.matrix_frac(turn * y / np.sqrt(n), m) <= y]
        u = cp.Variable((n, n), symmetric=True)
        if p == 0.5:
            self.log = 2.0 * cp.log(y)
            root_below = _schur(np.eye(n), turn @ u, m)
            return [root_below, cp.matrix_frac(np.eye(n) * y, u) <= n * y]
        constraints = [_schur(u, turn * y, m)]
        for _ in range(int(np.log2(p)) - 1):
            u, last = cp.Variable((n, n), symmetric=True), u
            constraints.append(_schur(u, last, y * np.eye(n)))
        return [*constraints, cp.norm(u, "fro") <= np.sqrt(n) * y]

    def support(self, m: Array) -> Support:
        """A line above log phi (for E and O3, above log l_min) near M.

        Where phi has kinks, the solver's dual selects the line.
        """
        duals = [c.dual_value for c in self.constraints]
        has_duals = bool(duals) and duals[0] is not None
        if isinstance(self.criterion, ExtremeEigenvalues):
            if has_duals:
                return Support(0.0, dual_root(self.turn.T @ duals[0] @ self.turn))
            return Support(0.0, np.asarray(np.linalg.eigh(m)[1][:, :1]))
        if isinstance(self.criterion, LargestVariance) and has_duals:
            shares = np.maximum(np.array(duals, dtype=float).reshape(-1), MIN_SHARE)
            roots = np.sqrt(shares / shares.sum())[:, None, None]
            mean = Variance((self.criterion.factors * roots).reshape(-1, len(m)))
            return mean.support(m)
        return self.criterion.support(m)


def _schur(corner: Any, side: Any, other: Any) -> Any:
    """corner >= side^T other^-1 side, by Schur's complement."""
    return cp.bmat([[corner, side.T], [side, other]]) >> 0


def dual_root(dual: Array) -> Array:
    """R (n, n) with R R^T the dual made symmetric, semidefinite and of trace 1."""
    eigenvalues, eigenvectors = np.linalg.eigh(0.5 * (dual + dual.T))
    eigenvalues = np.maximum(eigenvalues, 0.0)
    return np.asarray(eigenvectors * np.sqrt(eigenvalues / eigenvalues.sum()))


@dataclasses.dataclass(frozen=True, eq=False)
class Polytope:
    """The feasible weights; limits are kept to 1e-7 of a weight."""

    size: float  #: N
    caps: Array  #: (C,)
    rows: Array  #: (L, C) of the limits rows w <= upper
    upper: Array  #: (L,)

    def maximise(self, gains: Array) -> tuple[float, Array]:
        """A bound of sum_i w_i gains_i, and weights (C,) that (nearly) attain it."""
        if not len(self.upper):
            weights = knapsack_weights(gains, self.size, self.caps)
            return float(gains @ weights), weights
        scale = max(float(np.abs(gains).max()), 1e-300)
        solution = self._solve_linear(-gains / scale, self.rows, self.upper)
        marginals = np.asarray(solution.ineqlin.marginals, dtype=float)
        prices = scale * np.maximum(-marginals, 0.0)
        reduced = gains - prices @ self.rows
        bound = float(prices @ self.upper)
        bound += knapsack_value(reduced, self.size, self.caps)
        return bound, np.asarray(solution.x)

    def nearest(self, weights: Array) -> Array:
        """Feasible weights nearest to `weights` in their sum. Raises ValueError."""
        weights = np.clip(weights, 0.0, self.caps)
        if not len(self.upper):
            return self._rescale(weights)
        # variables: the weights w, and the differences d >= |w - weights|
        one = sparse.eye_array(len(weights))
        rows = sparse.csr_array(self.rows)
        matrix = sparse.block_array([[rows, None], [one, -one], [-one, -one]])
        upper = np.concatenate([self.upper, weights, -weights])
        cost = np.repeat([0.0, 1.0], len(weights))
        solution = self._solve_linear(cost, matrix, upper)
        return np.asarray(np.clip(solution.x[: len(weights)], 0.0, self.caps))

    def _rescale(self, weights: Array) -> Array:
        """Weights scaled down, or raised in proportion to the room below the caps."""
        missing = self.size - weights.sum()
        if missing <= 0.0:
            return np.asarray(weights * (self.size / weights.sum()))
        room = self.caps - weights
        if missing > room.sum() * (1 + 1e-12):
            raise ValueError(
                f"caps of {self.caps.sum():g} in all cannot carry a weight of {self.size:g}"
            )
        return np.asarray(weights + room * min(missing / room.sum(), 1.0))

    def _solve_linear(self, cost: Array, matrix: Any, upper: Array) -> Any:
        """Minimises cost^T x; the first variables are weights, others positive."""
        count = len(self.caps)
        extra = len(cost) - len(self.caps)
        sum_row = np.repeat([1.0, 0.0], [count, extra])[None]
        bounds = np.zeros((len(cost), 2))
        bounds[:, 1] = np.append(self.caps, np.full(extra, np.inf))
        solution = optimize.linprog(
            cost, matrix, upper, sum_row, [self.size], bounds, method="highs"
        )
        if solution.status != 0:
            raise ValueError(
                f"no weights keep size, caps and limits: {solution.message}"
            )
        return solution


Solver = Literal["CLARABEL", "SCS"]


class NoConicAnswerError(ValueError):
    """The conic solver ended without an answer; the text says what to use instead."""


RATIO_TOLERANCE = 1e-10  #: relative accuracy of the least ratio of kappa
#: number of Dinkelbach's steps towards it, which converge superlinearly
MAX_RATIO_STEPS = 30


def relax(
    rows: Array,
    size: float,
    criterion: Criterion,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    limits: tuple[Array, Array] | None = None,
    solver: Solver = "CLARABEL",
) -> Relaxation:
    """Optimal weights of candidates (C, n) or (C, k, n), value and bound as log phi,
    under limits rows w <= upper. Raises ValueError where no weights keep size, caps and
    limits, for undetermined directions, or for a criterion that has no conic form here.
    """
    blocks = block_array(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    limit_rows, upper = limits or (np.zeros((0, count)), np.zeros(0))
    feasible = Polytope(size, caps, limit_rows, upper)
    base = np.zeros((n, n)) if prior is None else np.asarray(prior, dtype=float)
    # of a good plan without limits
    weights = relaxation.determined_start(blocks, base, size, cap)
    typical = base + information(blocks, weights)
    problem = _ConicProblem(blocks, base, feasible, typical)
    if isinstance(criterion, ExtremeEigenvalues) and not criterion.concave:
        return _relax_condition(problem, criterion, solver)
    return _relax_concave(problem, criterion, solver)


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
    pairs = zip(shares, terms, strict=True)
    goal = cp.Maximize(sum(share * term.log for share, term in pairs))
    constraints = problem.limits(variable)
    for term in terms:
        constraints += term.constraints
    _solve(goal, constraints, solver)
    weights = _feasible_weights(problem, variable.value)
    m_at_weights = problem.information(weights)
    supports = [term.support(m_at_weights) for term in terms]
    offset, root = join_supports(shares, supports, m_at_weights)
    line_gradient = weight_gradient(problem.blocks, root)
    weighted = problem.feasible.maximise(line_gradient)[0] + problem.base_term(root)
    # the line is one of the least eigenvalue, of which E or O3 is a power
    power = criterion.least if isinstance(criterion, ExtremeEigenvalues) else 1.0
    bound = float(power * (offset + np.log(weighted)) + LOG_ROUNDING)
    value = criterion.value(m_at_weights)
    return Relaxation(weights, value, bound, power * line_gradient)


def _feasible_weights(problem: _ConicProblem, weights: Array | None) -> Array:
    """The solver's weights, or even ones without an answer, made feasible."""
    if weights is None:
        caps = problem.feasible.caps
        weights = caps * (problem.feasible.size / caps.sum())
    return problem.feasible.nearest(np.asarray(weights))


def _relax_condition(
    problem: _ConicProblem, criterion: ExtremeEigenvalues, solver: Solver
) -> Relaxation:
    """Least s with 1 <= tau M0 + sum u_i A_i <= s 1, w = u / tau, up to scales."""
    if criterion.least != criterion.largest:
        raise NoConicAnswerError(
            f"{criterion.name} has no conic form: see oed.design.condition"
        )
    tau, s = cp.Variable(nonneg=True), cp.Variable()
    identity = np.eye(len(problem.base))
    eigenvalues = np.linalg.eigvalsh(problem.typical)
    u = problem.weights()
    turn = problem.turn
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
    low, high = weight_gradient(problem.blocks, y), weight_gradient(problem.blocks, z)
    base_low, base_high = problem.base_term(y), problem.base_term(z)
    value = criterion.value(problem.information(weights))
    start = float(np.exp(-value / criterion.least))
    ratio = _least_ratio(problem.feasible, (base_low, low), (base_high, high), start)
    by_low = low / (base_low + low @ weights)
    by_high = high / (base_high + high @ weights)
    bound = float(-criterion.least * np.log(max(ratio, 1e-300)) + LOG_ROUNDING)
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
    (base_low, low_gradient), (base_high, high_gradient) = low, high
    for k in range(MAX_RATIO_STEPS):
        excess, best = feasible.maximise(ratio * low_gradient - high_gradient)
        if ratio * base_low - base_high + excess <= RATIO_TOLERANCE * ratio:
            return ratio
        numerator = base_high + high_gradient @ best
        lower_step = ratio * (1 - RATIO_TOLERANCE * 2.0**k)
        ratio_here = float(numerator / (base_low + low_gradient @ best))
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
