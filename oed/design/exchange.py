"""Choice of N candidates by exchange, with a certificate.

The relaxation (`oed.design.relaxation`) comes first: it gives the bound, and its slopes tell which candidates an
optimal plan can want, so that exchanges run over a small pool. A plan is improved until no exchange helps, then a few
of its readings are thrown out at random and it is improved again (iterated local search); the best plan is finally
improved over all candidates, and is never below the greedy one.

D: replacing i by j multiplies det M by (1 - d_ii)(1 + d_jj) + d_ij^2, d_ij = x_i^T M^-1 x_j (Fedorov 1972); for blocks
of rows, i is taken out and the best j put in. E: exchanges lower tr M^-p, computed exactly (`oed.design.power`), while
p grows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np

from oed import criteria
from oed.batch import Array
from oed.design import certificate, e_relaxation, relaxation
from oed.design.blocks import Index, as_blocks, information, seen
from oed.design.power import after_adding

#: candidates in the pool: at the least, and a chosen one
POOL, POOL_PER_READING = 200, 8
#: relative gain below which an exchange counts as none
GAIN = 1e-9
#: powers of the continuation towards E
POWERS = (1, 2, 4, 8, 16)
#: sweeps at the most: rounding near a singular plan could let two exchanges undo each other for ever
SWEEPS = 50
#: digits that the power series may lose; rows whose eigenvalues are computed instead
DIGITS, SHORTLIST = 8.0, 32
#: log det within this of the bound is proven optimal
PROVEN = 1e-6

Improve = Callable[[Array, Index], Index]


@dataclasses.dataclass(frozen=True)
class Choice:
    """Chosen candidates.

    indices     ascending
    value       criterion over the `directions` that candidates and prior see
    bound       no plan of as many candidates exceeds it; None where none was computed
    gap         what is known of the bound's own slack as a relaxation (log det)
    efficiency  D: exp((value - bound) / directions); E: value / bound
    """

    indices: Index
    criterion: str
    value: float
    directions: int
    bound: float | None = None
    gap: float | None = None

    @property
    def efficiency(self) -> float | None:
        """Share of the best possible that the plan is certain to have."""
        if self.bound is None:
            return None
        if self.criterion == "D":
            return certificate.d_efficiency(self.value, self.bound, self.directions)
        return self.value / self.bound

    @property
    def proven(self) -> bool:
        """Whether no better plan exists, up to rounding."""
        return self.bound is not None and self.bound - self.value <= PROVEN


def choose(
    rows: Array,
    size: int,
    rng: np.random.Generator,
    criterion: Literal["D", "E"] = "D",
    prior: Array | None = None,
    starts: int = 20,
    tolerance: float = 1e-6,
    certify: bool = True,
) -> Choice:
    """Choose `size` different candidates out of rows (C, n) or blocks (C, k, n), whitened and scaled.

    prior (n, n) is information held already. Without one, the design lives in the directions that the
    candidates together can see (singular values above `tolerance` of the largest): no plan sees more. `starts`
    rounds of local search are made. The bound comes with D at no cost; for E, `certify` = False leaves it out.
    Raises ValueError where there are too few candidates, or fewer readings than directions.
    """
    blocks = as_blocks(rows)
    _check(blocks, size, criterion)
    blocks, basis = seen(blocks, prior, tolerance)
    n = blocks.shape[2]
    base = np.zeros((n, n)) if prior is None else basis.T @ prior @ basis
    if prior is None and size * blocks.shape[1] < n:
        raise ValueError(f"{size} readings cannot determine the {n} directions the candidates see")
    relaxed = relaxation.relax(blocks, size, base)
    pool = _pool(relaxed, size)
    improve, judge = _tools(criterion, base)
    chosen = _search(blocks[pool], relaxed, pool, size, rng, starts, improve, judge)
    best = improve(blocks, chosen)
    greedy = improve(blocks, greedy_d(blocks, size, base))
    if judge(blocks[greedy]) > judge(blocks[best]):
        best = greedy
    value = judge(blocks[best])
    bound, gap = _certified(blocks, size, base, relaxed, criterion) if criterion == "D" or certify else (None, None)
    return Choice(np.sort(best), criterion, value, n, bound, gap)


def _certified(
    blocks: Array, size: int, base: Array, relaxed: relaxation.Relaxed, criterion: str
) -> tuple[float, float]:
    """The bound, and by how much it may be loose as a relaxation."""
    if criterion == "D":
        return relaxed.bound, relaxed.gap
    found = e_relaxation.relax(blocks, size, base)
    return found.bound, found.bound - found.value


def greedy_d(blocks: Array, size: int, base: Array) -> Index:
    """Candidates taken one by one, each the one that raises log det most (a ridge stands in for what is unseen)."""
    n = blocks.shape[2]
    ridge = 1e-9 * float(np.mean(np.sum(blocks**2, axis=(1, 2)))) * np.eye(n)
    inverse = _inverse(base + ridge)
    free = np.ones(len(blocks), dtype=bool)
    chosen = []
    for _ in range(size):
        gain = np.where(free, _added(blocks, inverse), -np.inf)
        best = int(np.argmax(gain))
        chosen.append(best)
        free[best] = False
        inverse = _with(inverse, blocks[best], 1.0)
    return np.array(chosen, dtype=np.intp)


# -- search ------------------------------------------------------------------------------------------------


def _check(blocks: Array, size: int, criterion: str) -> None:
    if not 0 < size <= len(blocks):
        raise ValueError(f"cannot choose {size} different readings out of {len(blocks)} candidates")
    if criterion not in ("D", "E"):
        raise ValueError(f"exchange knows the criteria D and E, not {criterion!r}")
    if criterion == "E" and blocks.shape[1] > 1:
        raise ValueError("E exchange takes candidates of one row each")


def _pool(relaxed: relaxation.Relaxed, size: int) -> Index:
    most = min(len(relaxed.slopes), max(POOL, POOL_PER_READING * size))
    best = np.argsort(-relaxed.slopes, kind="stable")[:most]
    return np.union1d(best, np.flatnonzero(relaxed.weights > 0)).astype(np.intp)


def _tools(criterion: str, base: Array) -> tuple[Improve, Callable[[Array], float]]:
    def d_value(chosen: Array) -> float:
        return criteria.d(base + information(chosen))

    def e_value(chosen: Array) -> float:
        return criteria.e(base + information(chosen))

    if criterion == "D":
        return (lambda blocks, chosen: _improve_d(blocks, chosen, base)), d_value
    return (lambda blocks, chosen: _improve_e(blocks, chosen, base)), e_value


def _search(
    blocks: Array,
    relaxed: relaxation.Relaxed,
    pool: Index,
    size: int,
    rng: np.random.Generator,
    rounds: int,
    improve: Improve,
    judge: Callable[[Array], float],
) -> Index:
    """Iterated local search over the pool; candidates of the whole set are returned."""
    weights = relaxed.weights[pool] + 1e-4 * relaxed.weights.sum() / len(pool)
    best, value = np.zeros(0, dtype=np.intp), -np.inf
    fresh = max(1, min(5, rounds // 4))
    for k in range(rounds):
        start = _rounded(weights, size, rng) if k < fresh or not best.size else _shaken(best, len(pool), rng)
        chosen = improve(blocks, start)
        reached = judge(blocks[chosen])
        if reached > value or not best.size:
            best, value = chosen, reached
    return pool[best]


def _rounded(weights: Array, size: int, rng: np.random.Generator) -> Index:
    """Different candidates drawn with chances that follow the relaxed weights (Gumbel's trick)."""
    keys = np.log(weights) + rng.gumbel(size=len(weights))
    return np.argsort(-keys, kind="stable")[:size].astype(np.intp)


def _shaken(chosen: Index, count: int, rng: np.random.Generator) -> Index:
    """The plan with two to six of its candidates replaced at random."""
    others = np.setdiff1d(np.arange(count), chosen)
    most = min(6, len(chosen), len(others))
    if most == 0:
        return chosen.copy()
    out = rng.choice(len(chosen), size=int(rng.integers(min(2, most), most + 1)), replace=False)
    shaken = chosen.copy()
    shaken[out] = rng.choice(others, size=len(out), replace=False)
    return shaken


# -- D -----------------------------------------------------------------------------------------------------


def _improve_d(blocks: Array, chosen: Index, base: Array) -> Index:
    chosen = chosen.copy()
    ridge = 1e-12 * float(np.trace(information(blocks[chosen]) + base)) / base.shape[0] * np.eye(base.shape[0])
    if blocks.shape[1] == 1:
        return _pairs_d(blocks[:, 0], chosen, base + ridge)
    for _ in range(SWEEPS):
        if not _sweep_d(blocks, chosen, base + ridge):
            break
    return chosen


def _pairs_d(rows: Array, chosen: Index, base: Array) -> Index:
    """The best pair each time, by Fedorov's formula."""
    inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    for count in range(100 * len(chosen)):
        projected = rows @ inverse
        own = np.einsum("ij,ij->i", projected, rows)
        factor = (1.0 - own[chosen])[:, None] * (1.0 + own)[None, :] + (projected[chosen] @ rows.T) ** 2
        factor[:, chosen] = 0.0
        i, j = divmod(int(factor.argmax()), factor.shape[1])
        if factor[i, j] <= 1.0 + GAIN:
            break
        inverse = _with(_with(inverse, rows[None, j], 1.0), rows[None, chosen[i]], -1.0)
        chosen[i] = j
        if count % 50 == 49:  # rank-one updates lose digits
            inverse = _inverse(rows[chosen].T @ rows[chosen] + base)
    return chosen


def _sweep_d(blocks: Array, chosen: Index, base: Array) -> bool:
    """Each chosen block in turn is taken out and the best one put in; tells whether any changed."""
    changed = False
    for place in range(len(chosen)):
        rest = np.delete(chosen, place)
        inverse = _inverse(base + information(blocks[rest]))
        gain = _added(blocks, inverse)
        gain[rest] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] > gain[chosen[place]] + GAIN:
            chosen[place], changed = best, True
    return changed


def _added(blocks: Array, inverse: Array) -> Array:
    """Growth (C,) of log det M when a block is added: log det(I + X M^-1 X^T)."""
    if blocks.shape[1] == 1:
        rows = blocks[:, 0]
        return np.asarray(np.log1p(np.einsum("ij,ij->i", rows @ inverse, rows)))
    inner = blocks @ inverse @ np.swapaxes(blocks, 1, 2)
    return np.asarray(np.linalg.slogdet(inner + np.eye(blocks.shape[1]))[1])


def _inverse(m: Array) -> Array:
    return np.asarray(np.linalg.inv(m), dtype=float)


def _with(inverse: Array, block: Array, sign: float) -> Array:
    """(M + sign X^T X)^-1 from M^-1 (Woodbury)."""
    side = inverse @ block.T
    return np.asarray(inverse - side @ np.linalg.solve(sign * np.eye(len(block)) + block @ side, side.T))


# -- E -----------------------------------------------------------------------------------------------------


def _improve_e(blocks: Array, chosen: Index, base: Array) -> Index:
    rows, chosen = blocks[:, 0], chosen.copy()
    for p in POWERS:
        for _ in range(SWEEPS):
            if not _sweep_e(rows, chosen, base, p):
                break
    for _ in range(SWEEPS):
        if not _sweep_e(rows, chosen, base, None):
            break
    return chosen


def _sweep_e(rows: Array, chosen: Index, base: Array, p: int | None) -> bool:
    """Each chosen row in turn is replaced by the best one; tells whether any changed.

    The best makes tr M^-p least, or, where p is None, the least eigenvalue largest.
    """
    changed = False
    m = base + rows[chosen].T @ rows[chosen]
    for place in range(len(chosen)):
        rest = m - np.outer(rows[chosen[place]], rows[chosen[place]])
        cost, order = _costs(rows, rest, float(np.linalg.eigvalsh(m)[0]), p, chosen[place])
        here = cost[order == chosen[place]][0]
        cost = np.where(np.isin(order, chosen), np.inf, cost)
        best = int(np.argmin(cost))
        if cost[best] < here - GAIN * abs(here):
            chosen[place], changed = order[best], True
        m = rest + np.outer(rows[chosen[place]], rows[chosen[place]])
    return changed


def _costs(rows: Array, rest: Array, now: float, p: int | None, old: int) -> tuple[Array, Index]:
    """What to make small when a row joins `rest`, and the rows it is told for.

    The series loses (now / least eigenvalue of rest)^p in digits; where that is too much, and for p None, the
    eigenvalues themselves are computed for the most promising rows.
    """
    values, vectors = np.linalg.eigh(rest)
    floor = np.maximum(values, 1e-12 * values[-1])
    lost = (p or 1) * np.log10(max(1.0, now / floor[0]))
    if p is not None and lost < DIGITS:
        return after_adding(floor, vectors, rows, p), np.arange(len(rows))
    rank = after_adding(np.maximum(values, 1e-6 * values[-1]), vectors, rows, 1)
    best = np.argsort(rank, kind="stable")[:SHORTLIST]
    order = np.asarray(best if old in best else np.append(best, old), dtype=np.intp)
    joined: Array = np.asarray(np.linalg.eigvalsh(rest + rows[order, :, None] * rows[order, None, :]), dtype=float)
    if p is None:
        return -joined[:, 0], order
    return np.asarray(np.sum(np.maximum(joined / now, 1e-12) ** -float(p), axis=1), dtype=float), order
