"""The least eigenvalue that any plan can reach: the convex relaxation of the E-optimal choice, with its certificate.

    maximise t   over   M0 + sum_i w_i A_i >= t I,   0 <= w_i <= cap,   sum_i w_i = N.

A general conic solver works on a growing active set of candidates; its dual matrix Z (projected to positive
semidefinite, trace 1) is all that is taken from it: lambda_min(M') <= tr(Z M') holds for every plan and any such Z, so
the bound is computed from Z over all candidates and stays valid whatever the solver says of itself.
"""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np

from oed.batch import Array
from oed.design.blocks import Index, as_blocks, information
from oed.design.certificate import e_bound

ROUNDS = 30
#: candidates in the first active set, and added in a round
START, MORE = 200, 100


@dataclasses.dataclass(frozen=True)
class ERelaxed:
    """Weights (C,), their least eigenvalue `value`, and a valid upper `bound` of every feasible plan's.

    slopes (C,): tr(Z A_i) at the dual that gives the bound
    """

    weights: Array
    value: float
    bound: float
    slopes: Array


def relax(
    rows: Array, size: float, prior: Array | None = None, cap: Array | float = 1.0, tolerance: float = 1e-4
) -> ERelaxed:
    """Relaxed E-optimal weights of candidates (C, n) or (C, k, n), to a relative gap of `tolerance`."""
    blocks = as_blocks(rows)
    count, _, n = blocks.shape
    caps = np.minimum(np.broadcast_to(np.asarray(cap, dtype=float), (count,)), size)
    if caps.sum() < size * (1 - 1e-12):
        raise ValueError(f"{count} candidates of at most {np.max(cap):g} each cannot carry a weight of {size:g}")
    base = np.zeros((n, n)) if prior is None else prior
    order = np.argsort(-np.sum(blocks**2, axis=(1, 2)), kind="stable")
    active = order[: max(START, int(np.searchsorted(np.cumsum(caps[order]), size)) + 2)]
    best, weights, value, slopes = np.inf, np.zeros(count), -np.inf, np.zeros(count)
    for _ in range(ROUNDS):
        some, dual = _solve(blocks[active], size, base, caps[active])
        told = np.einsum("ckn,nm,ckm->c", blocks, dual, blocks, optimize=True)
        reached_bound = e_bound(dual, base, told, size, caps)
        if reached_bound < best:
            best, slopes = reached_bound, told
        reached = float(np.linalg.eigvalsh(base + information(blocks[active], some))[0])
        if reached > value:
            value, weights = reached, np.zeros(count)
            weights[active] = some
        if best - value <= tolerance * abs(best):
            break
        wanted = _missing(told, active)
        if not wanted.size:
            break
        active = np.concatenate([active, wanted])
    return ERelaxed(weights, value, best, slopes)


def _solve(blocks: Array, size: float, base: Array, cap: Array) -> tuple[Array, Array]:
    """Weights on the active set (made feasible) and the dual matrix (made feasible).

    The solver sees T (M - t I) T^T with T M_uniform T^T = I, which has the same sign but entries near one. Where it
    fails all the same, the dual is M^-3 of the last matrix known: any dual gives a bound, if a looser one.
    """
    import cvxpy as cp

    n = blocks.shape[2]
    uniform = np.full(len(blocks), size / len(blocks))
    middle = base + information(blocks, uniform) + 1e-12 * np.trace(information(blocks, uniform)) * np.eye(n)
    root = np.linalg.inv(np.linalg.cholesky(middle))
    least = float(np.linalg.eigvalsh(middle)[0])
    white = blocks @ root.T
    products = np.einsum("ckn,ckm->cnm", white, white).reshape(len(blocks), -1)
    w, t = cp.Variable(len(blocks), nonneg=True), cp.Variable()
    m = root @ base @ root.T + cp.reshape(products.T @ w, (n, n), order="C")
    above = 0.5 * (m + m.T) >> t * (least * root @ root.T)
    problem = cp.Problem(cp.Maximize(t), [above, cp.sum(w) == size, w <= cap])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate solution only loosens the bound, which is told by its value
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return uniform, _dual(np.linalg.matrix_power(np.linalg.inv(middle), 3))
    if w.value is None or above.dual_value is None:
        return uniform, _dual(np.linalg.matrix_power(np.linalg.inv(middle), 3))
    weights = np.clip(np.asarray(w.value, dtype=float), 0.0, cap)
    weights *= min(1.0, size / float(weights.sum()))  # never above the size; a little below only loses value
    return weights, _dual(root.T @ above.dual_value @ root)


def _dual(matrix: Array) -> Array:
    """The matrix as a feasible dual: symmetric, positive semidefinite, trace 1."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    values = np.maximum(values, 0.0)
    return np.asarray((vectors * (values / values.sum())) @ vectors.T)


def _missing(told: Array, active: Index) -> Index:
    """Candidates outside the active set that carry more than the least wanted inside, the most wanted first."""
    outside = np.ones(len(told), dtype=bool)
    outside[active] = False
    level = float(np.median(told[active]))
    wanted = np.flatnonzero(outside & (told > level))
    return wanted[np.argsort(-told[wanted], kind="stable")[:MORE]].astype(np.intp)
