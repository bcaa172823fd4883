"""D-optimal weights: the convex relaxation of the choice, solved to rounding, with its certificate.

    maximise  log det(M0 + sum_i w_i X_i^T X_i)   over  0 <= w_i <= cap,  sum_i w_i = N.

Every exact plan of N candidates is feasible (cap 1: no repeats; cap inf: repeats allowed), so the optimum bounds it.
Method: an active set of candidates, on which Newton steps are taken in the face of the free weights (the Hessian is
-(K o K) for K = X M^-1 X^T, so a step costs one solve the size of the support); candidates whose slope exceeds the
multiplier join, weights that reach a bound leave. Where Newton steps end, the equivalence theorem (Kiefer and
Wolfowitz 1960) is checked over all candidates.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.batch import Array
from oed.design.blocks import Index, as_blocks, gradient, information, whitened
from oed.design.certificate import d_bound

#: rounds of adding candidates; Newton steps in each
ROUNDS, STEPS = 200, 8
#: candidates in the first active set, at the least and a direction
START, START_PER_DIRECTION = 60, 6
#: candidates beyond which the start is sought in a sample of them
SAMPLE = 6000


@dataclasses.dataclass(frozen=True)
class Relaxed:
    """Optimal weights.

    weights  (C,) sum N;  value log det at them;  bound a valid upper bound of every feasible plan's log det
    slopes   (C,) tr(M^-1 X_i^T X_i) at the optimum: the larger, the more a candidate is wanted
    gap      bound - value: what the certificate knows the bound to be loose by, as a relaxation
    """

    weights: Array
    value: float
    bound: float
    slopes: Array

    @property
    def gap(self) -> float:
        """bound - value."""
        return self.bound - self.value


def relax(rows: Array, size: float, prior: Array | None = None, cap: float = 1.0, tolerance: float = 1e-7) -> Relaxed:
    """Relaxed D-optimal weights of candidates (C, n) or (C, k, n), to a gap of `tolerance` in log det.

    Raises ValueError where cap * C < size, or where candidates and prior leave directions unseen.
    """
    blocks = as_blocks(rows)
    count, _, n = blocks.shape
    if cap * count < size:
        raise ValueError(f"{count} candidates of at most {cap} each cannot carry a weight of {size}")
    base = np.zeros((n, n)) if prior is None else prior
    cap = min(cap, size)
    support, weights = _start(blocks, size, base, cap)
    value, bound, slopes = -np.inf, np.inf, np.zeros(count)
    for _ in range(ROUNDS):
        weights = _newton(blocks[support], weights, base, cap)
        m = base + information(blocks[support], weights)
        slopes = gradient(blocks, m)
        value = float(np.linalg.slogdet(m)[1])
        bound = min(bound, d_bound(m, base, slopes, size, cap))
        if bound - value < tolerance:
            break
        support, weights = _joined(support, weights, slopes, cap, 2 * n)
    full = np.zeros(count)
    full[support] = weights
    return Relaxed(full, value, bound, slopes)


def _start(blocks: Array, size: float, base: Array, cap: float) -> tuple[Index, Array]:
    """A first support with feasible weights, from a few multiplicative steps on (a sample of) the candidates."""
    count, _, n = blocks.shape
    stride = max(1, count // SAMPLE)
    chosen = np.arange(0, count, stride)
    some = blocks[chosen]
    weights = np.full(len(chosen), size / len(chosen))
    ridge = 1e-9 * np.trace(information(some, weights)) / n * np.eye(n)
    for _ in range(8):
        slopes = gradient(some, base + information(some, weights) + ridge)
        weights = weights * slopes
        weights *= size / weights.sum()
    wanted = max(START, START_PER_DIRECTION * n, int(np.ceil(2 * size / min(cap, size))))
    best = np.argsort(-weights, kind="stable")[:wanted]
    return chosen[best], _feasible(weights[best], size, cap)


def _feasible(weights: Array, size: float, cap: float) -> Array:
    """Weights scaled to the sum `size`, what exceeds the cap handed on to the others."""
    weights = np.maximum(weights, 1e-12)
    for _ in range(100):
        full = weights >= cap
        left = size - cap * full.sum()
        rest = weights[~full].sum()
        weights = np.where(full, cap, weights * (left / rest if rest > 0 else 1.0))
        if not (weights > cap * (1 + 1e-15)).any():
            break
    return np.minimum(weights, cap)


def _newton(blocks: Array, weights: Array, base: Array, cap: float) -> Array:
    """Newton steps over the free weights of the active set, each followed by a check that log det grew."""
    for _ in range(STEPS):
        m = base + information(blocks, weights)
        step, free = _direction(blocks, weights, m, cap)
        if not free.size or np.abs(step).max() <= 1e-13 * weights.sum():
            return weights
        weights, moved = _along(blocks, weights, step, free, base, float(np.linalg.slogdet(m)[1]), cap)
        if not moved:
            return weights
    return weights


def _direction(blocks: Array, weights: Array, m: Array, cap: float) -> tuple[Array, Index]:
    """Newton step over the weights that are free, or want to leave their bound; it keeps their sum."""
    white = whitened(blocks, m)
    flat = white.reshape(-1, white.shape[2])
    k = blocks.shape[1]
    cross = (flat @ flat.T) ** 2
    if k > 1:
        cross = cross.reshape(len(blocks), k, len(blocks), k).sum(axis=(1, 3))
    slopes = np.einsum("ckn,ckn->c", white, white)
    inside = (weights > 0) & (weights < cap)
    level = float(np.average(slopes, weights=np.where(inside, weights, 0.0))) if inside.any() else float(slopes.mean())
    free = np.flatnonzero(inside | ((weights <= 0) & (slopes > level)) | ((weights >= cap) & (slopes < level)))
    while free.size > 1:
        hessian = cross[np.ix_(free, free)]
        # more free weights than distinct information: the ridge picks the shortest of the equal steps
        hessian[np.diag_indices_from(hessian)] += 1e-10 * np.trace(hessian) / len(free)
        solved = np.linalg.solve(hessian, np.column_stack([slopes[free], np.ones(len(free))]))
        step = solved[:, 0] - solved[:, 0].sum() / solved[:, 1].sum() * solved[:, 1]
        outward = ((weights[free] <= 0) & (step < 0)) | ((weights[free] >= cap) & (step > 0))
        if not outward.any():
            return step, free
        free = free[~outward]
    return np.zeros(0), free[:0]


def _along(
    blocks: Array, weights: Array, step: Array, free: Index, base: Array, value: float, cap: float
) -> tuple[Array, bool]:
    """The longest share of a step that stays feasible and does not lower log det."""
    here = weights[free]
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(step < 0, here / -step, np.where(step > 0, (cap - here) / step, np.inf))
    share = min(1.0, float(room.min()))
    while share > 1e-12:
        trial = weights.copy()
        trial[free] = np.clip(here + share * step, 0.0, cap)
        trial[trial < 1e-14 * weights.sum()] = 0.0
        sign, reached = np.linalg.slogdet(base + information(blocks, trial))
        if sign > 0 and reached >= value - 1e-13 * max(1.0, abs(value)):
            return trial, True
        share *= 0.5
    return weights, False


def _joined(support: Index, weights: Array, slopes: Array, cap: float, most: int) -> tuple[Index, Array]:
    """The support less its zero weights, plus the candidates outside that are wanted most."""
    keep = weights > 0
    support, weights = support[keep], weights[keep]
    inside = weights < cap
    level = float(np.average(slopes[support][inside], weights=weights[inside])) if inside.any() else 0.0
    outside = np.ones(len(slopes), dtype=bool)
    outside[support] = False
    wanted = np.flatnonzero(outside & (slopes > level))
    wanted = wanted[np.argsort(-slopes[wanted], kind="stable")[:most]]
    return np.concatenate([support, wanted]), np.concatenate([weights, np.zeros(len(wanted))])
