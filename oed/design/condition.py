"""The least condition number that any plan can reach, and the largest O4 and E:
relaxations with certificates.

With M = M0 + sum_i w_i A_i, A_i = X_i^T X_i, its extreme eigenvalues l_min and l_max, 0
<= w_i <= cap_i, sum w = N,

    F(z) = max_w  l_min(M) - z l_max(M)

is a concave problem. F(0) is the E criterion; F(z) = 0 at z = 1 / kappa^2 of the best
plan, kappa = sqrt(l_max / l_min) (Dinkelbach 1967, Management Science 13, 492-498). As
l_min <= F(z) + z l_max for every z, lines of several z bound O4 = l_min / sqrt(l_max):
no plan lies above their lower envelope, and along a line O4 is largest at an end, so
only corners of the envelope can exceed what is known. The next z is the slope between
the plans on both sides of the worst corner (sandwich algorithm, Rote 1992, Computing
48, 337-361).

Bounds rest on dual points alone, whatever the method did. For any Y, Z positive
semidefinite of trace 1

    l_max(M) - s l_min(M) >= <Z - s Y, M>,       l_min(M) - z l_max(M) <= <Y - z Z, M>,

and their extremes over all weights are those of a fractional knapsack. So kappa^2 is at
least the least <Z, M> / <Y, M> over the weights, and F(z) at most the largest <Y - z Z,
M>.

Method: the path of `oed.design.interior`, on a growing active set of candidates.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from oed.arrays import Array, Index
from oed.design.blocks import information
from oed.design.certificate import carried
from oed.design.criterion.protocol import slopes
from oed.design.interior import InteriorPath, InteriorSetting, setting_of

#: rounds of joining candidates; steps of a path
ROUNDS, STEPS = 40, 60
#: candidates in the first active set, and joined in a round
START, MORE = 200, 100
#: share of the gap inside the active set at which a path ends: the rest is due to
#: candidates outside
INSIDE = 0.1
#: lines that bound O4 at the most
LINES = 16
#: rounding of traces, a share of the least eigenvalue (and of kappa)
SAFE = 1e-10


@dataclasses.dataclass(frozen=True)
class Conditioned:
    """Weights (C,), the criterion at them, and a `bound` of every feasible plan's.

    kappa: no plan lies below the bound; E and O4: none above it slopes (C,) of the log
    criterion (of -log kappa) along each weight: the larger, the more a candidate is
    wanted
    """

    weights: Array
    value: float
    bound: float
    slopes: Array

    @property
    def gap(self) -> float:
        """|log bound - log value|: how loose the bound is at the most, as a relaxation."""
        return float(abs(np.log(self.bound / self.value)))


def relax(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-4,
) -> Conditioned:
    """Least kappa(H) = sqrt(l_max / l_min) of weights on candidates (C, n) or (C, k,
    n), to a log gap `tolerance`.

    Raises ValueError where the caps cannot carry `size`, or candidates and prior leave
    directions unseen.
    """
    found = _follow(setting_of(rows, size, prior, cap), None, 2.0 * tolerance)
    kappa = float(np.sqrt(found.largest / found.least))
    return Conditioned(
        found.weights, kappa, float(np.sqrt(found.ratio)), 0.5 * _log_slopes(found, 1.0)
    )


def e_optimal(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-4,
) -> Conditioned:
    """Largest l_min (E), F(0). Raises as `relax`."""
    found = _follow(setting_of(rows, size, prior, cap), 0.0, tolerance)
    return Conditioned(found.weights, found.least, found.bound, _log_slopes(found, 0.0))


def o4(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-3,
) -> Conditioned:
    """Largest O4 = sigma_min^2 / sigma_max = l_min / sqrt(l_max), to a log gap
    `tolerance`. Raises as `relax`.
    """
    setting = setting_of(rows, size, prior, cap)
    ends = (
        _follow(setting, 0.0, 0.3 * tolerance),
        _follow(setting, None, 0.3 * tolerance),
    )
    lines = [
        (ends[0].bound, 0.0, ends[0]),
        (0.0, 1.0 / ends[1].ratio, ends[1]),
    ]  # l_min <= first + second l_max
    best = max(ends, key=_o4)
    while True:
        bound, low, high = _worst_corner(np.array([line[:2] for line in lines]))
        if np.log(bound / _o4(best)) <= tolerance or len(lines) >= LINES:
            return Conditioned(best.weights, _o4(best), bound, _log_slopes(best, 0.5))
        slope = _between(lines[low], lines[high])
        near = dataclasses.replace(setting, start=lines[low][2].weights)
        found = _follow(near, slope, 0.3 * tolerance)
        lines.append((found.bound, slope, found))
        best = max(best, found, key=_o4)


def _o4(found: _InteriorPoint) -> float:
    return float(found.least / np.sqrt(found.largest))


def _worst_corner(lines: Array) -> tuple[float, int, int]:
    """Largest l_min / sqrt(l_max) under lines (L, 2) b + z l_max, and the two lines
    that meet there, less steep first.

    The first line is level, one passes through the origin: the envelope's largest value
    is at a crossing.
    """
    b, z = lines.T
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (b[:, None] - b) / (z - z[:, None])
    low, high = np.nonzero(np.isfinite(at) & (at > 0) & (z > z[:, None]))
    at = at[low, high]
    height = np.min(b + at[:, None] * z, axis=1)
    worth = np.where(
        height >= (b[low] + at * z[low]) * (1 - 1e-12), height / np.sqrt(at), -np.inf
    )
    k = int(np.argmax(worth))
    return float(worth[k]) * (1.0 + SAFE), int(low[k]), int(high[k])


def _between(
    low: tuple[float, float, _InteriorPoint], high: tuple[float, float, _InteriorPoint]
) -> float:
    """Slope of the chord between the plans that two lines touch; halfway between theirs
    where it is not inside.
    """
    run = low[2].largest - high[2].largest
    chord = (low[2].least - high[2].least) / run if run > 0 else -1.0
    room = 0.01 * (high[1] - low[1])
    return (
        float(chord)
        if low[1] + room < chord < high[1] - room
        else 0.5 * (low[1] + high[1])
    )


# -- one value F(z) --------------------------------------------------------------------


class _Dual(NamedTuple):
    """Roots of Y and Z; <Y, M0> and <Z, M0>; `rise` <Y, A_i> and `growth` <Z, A_i>
    (C,).
    """

    held: tuple[float, float]
    rise: Array
    growth: Array


@dataclasses.dataclass(frozen=True, eq=False)
class _InteriorPoint:
    """Weights (C,) with their l_min and l_max, and what a dual says: F(slope) <= bound,
    or kappa^2 >= ratio.

    slope  None for kappa;  profit (C,) <Y - z Z, A_i> at the path's z
    inside, apart  how far the dual's value is above the weights' over the active set
                   and over all, shares of l_min
    """

    weights: Array
    least: float
    largest: float
    slope: float | None
    bound: float
    ratio: float
    dual: _Dual
    profit: Array
    inside: float
    apart: float

    @property
    def gap(self) -> float:
        """Of the bound, as a share of l_min; of the ratio, as a share of kappa^2."""
        if self.slope is None:
            return self.largest / self.least / self.ratio - 1.0
        return (self.bound - self.least + self.slope * self.largest) / self.least

    def better(self, other: _InteriorPoint) -> _InteriorPoint:
        """The better weights of two with the better dual of both."""
        if self.slope is None:
            plan, dual = (
                other.largest / other.least < self.largest / self.least,
                other.ratio > self.ratio,
            )
        else:
            z = self.slope
            plan, dual = (
                other.least - z * other.largest > self.least - z * self.largest,
                other.bound < self.bound,
            )
        best = self
        if plan:
            best = dataclasses.replace(
                best, weights=other.weights, least=other.least, largest=other.largest
            )
        return (
            dataclasses.replace(
                best, bound=other.bound, ratio=other.ratio, dual=other.dual
            )
            if dual
            else best
        )


def _log_slopes(found: _InteriorPoint, share: float) -> Array:
    """d/dw of log l_min - share log l_max."""
    return np.asarray(
        found.dual.rise / found.least - share * found.dual.growth / found.largest
    )


def _follow(
    setting: InteriorSetting, slope: float | None, tolerance: float
) -> _InteriorPoint:
    """F(slope), or the least kappa where no slope is told, to a share `tolerance` of
    l_min (of kappa^2).
    """
    if setting.caps.sum() <= setting.size * (1 + 1e-9):
        return _only(setting, slope)
    active = _first(setting)
    weights, centre = _carrying(setting, setting.start[active], active), 0.5
    best: _InteriorPoint | None = None
    for _ in range(ROUNDS):
        known = (
            0.0 if best is None else best.least / best.largest * (1.0 - 0.2 * tolerance)
        )
        path = InteriorPath(setting.take(active), slope, weights, centre, known)
        now: _InteriorPoint | None = None
        for _ in range(STEPS):
            if not path.step():
                break
            now = _told(setting, path, active)
            best = now if best is None else best.better(now)
            if slope is None:
                # a little below the best plan's: at its own, plans of any size would do
                # equally well
                path.slope = min(
                    3.0 * path.slope,
                    best.least / best.largest * (1.0 - 0.2 * tolerance),
                )
            if best.gap <= tolerance or now.inside < INSIDE * now.apart:
                break
        if now is None or best is None or best.gap <= tolerance:
            break
        wanted = _wanted(setting, now.profit, active)
        if not wanted.size:
            break
        active, weights = _joined(setting, now.profit, path.w, active, wanted)
        centre = float(np.clip(now.apart, 0.02, 0.3))
    if best is None:
        raise ValueError(
            "the scales of the columns differ too much for their condition number:"
            " scale them"
        )
    return best


def _told(
    setting: InteriorSetting, path: InteriorPath, active: Index
) -> _InteriorPoint:
    """What a path's weights and duals say about all candidates."""
    dual = _dual(setting, path)
    least, largest = setting.ends(active, path.w)
    profit = dual.rise - path.slope * dual.growth
    held = dual.held[0] - path.slope * dual.held[1]
    value = least - path.slope * largest
    inside = (
        held + carried(profit[active], setting.size, setting.caps[active]) - value
    ) / least
    bound = held + carried(profit, setting.size, setting.caps)
    safe = SAFE + 4e-16 * float(np.sqrt(largest / least))
    ratio = (
        _least_ratio(setting, dual, largest / least) * (1.0 - safe)
        if path.free
        else 0.0
    )
    full = np.zeros(len(profit))
    full[active] = path.w
    slope = None if path.free else path.slope
    apart = (bound - value) / least
    return _InteriorPoint(
        full,
        least,
        largest,
        slope,
        bound + safe * least,
        ratio,
        dual,
        profit,
        inside,
        apart,
    )


def _dual(setting: InteriorSetting, path: InteriorPath) -> _Dual:
    """The path's Y and Z at trace 1, over all candidates."""
    y, z = np.asarray(np.linalg.cholesky(path.y)), np.zeros((len(path.y), 1))
    y = y / float(np.linalg.norm(setting.turn.T @ y))
    if path.slope:
        z = np.asarray(np.linalg.cholesky(path.z))
        z = z / float(np.linalg.norm(z))
    held = (
        float(np.sum((setting.white_base @ y) * y)),
        float(np.sum((setting.base @ z) * z)),
    )
    return _Dual(held, slopes(setting.white, y), slopes(setting.blocks, z))


def _least_ratio(setting: InteriorSetting, dual: _Dual, ratio: float) -> float:
    """The least <Z, M> / <Y, M> over all weights, by Dinkelbach's steps down from any
    `ratio` above it.
    """
    for _ in range(100):
        order = np.argsort(dual.growth - ratio * dual.rise, kind="stable")
        w = _filled(setting.caps[order], setting.size)
        above, below = (
            dual.held[1] + dual.growth[order] @ w,
            dual.held[0] + dual.rise[order] @ w,
        )
        if above >= ratio * below * (1 - 1e-14):
            return ratio
        ratio = float(above / below)
    return 0.0


def _filled(caps: Array, size: float) -> Array:
    """Candidates filled to their caps, in the order given, until the size is used up."""
    return np.asarray(np.clip(size - (np.cumsum(caps) - caps), 0.0, caps))


def _only(setting: InteriorSetting, slope: float | None) -> _InteriorPoint:
    """The one plan there is where the caps leave no choice."""
    everyone = np.arange(len(setting.blocks))
    least, largest = setting.ends(everyone, setting.caps)
    vectors = np.linalg.eigh(setting.base + information(setting.blocks, setting.caps))[
        1
    ]
    dual = _Dual(
        (0.0, 0.0),
        slopes(setting.blocks, vectors[:, :1]),
        slopes(setting.blocks, vectors[:, -1:]),
    )
    bound = least - (slope or 0.0) * largest + SAFE * least
    return _InteriorPoint(
        setting.caps.copy(),
        least,
        largest,
        slope,
        bound,
        largest / least * (1 - SAFE),
        dual,
        dual.rise,
        0.0,
        0.0,
    )


# -- the active set --------------------------------------------------------------------


def _first(setting: InteriorSetting) -> Index:
    """The support of the start and an even sample, able to carry more than the size."""
    count, stride = len(setting.caps), max(1, len(setting.caps) // START)
    while True:
        active = np.union1d(
            np.flatnonzero(setting.start > 1e-4 * setting.caps),
            np.arange(0, count, stride),
        )
        if stride == 1 or setting.caps[active].sum() >= 1.5 * setting.size:
            return active
        stride //= 2


def _wanted(setting: InteriorSetting, profit: Array, active: Index) -> Index:
    """Candidates outside that a knapsack would rather carry than the last it carries
    inside, the best first.
    """
    order = active[np.argsort(-profit[active], kind="stable")]
    last = int(np.searchsorted(np.cumsum(setting.caps[order]), setting.size))
    outside = np.ones(len(profit), dtype=bool)
    outside[active] = False
    wanted = np.flatnonzero(
        outside & (profit > profit[order[min(last, len(order) - 1)]])
    )
    return np.asarray(wanted[np.argsort(-profit[wanted], kind="stable")[:MORE]])


def _joined(
    setting: InteriorSetting, profit: Array, held: Array, active: Index, wanted: Index
) -> tuple[Index, Array]:
    """The active set without what carries nothing, with what is wanted; weights of the
    same sum.
    """
    order = np.argsort(-profit, kind="stable")
    top = order[
        : int(np.searchsorted(np.cumsum(setting.caps[order]), 1.5 * setting.size)) + 2
    ]
    full = np.zeros(len(profit))
    full[active] = np.where(held > 1e-4 * setting.caps[active], held, 0.0)
    joined = np.union1d(np.union1d(np.flatnonzero(full), wanted), top)
    return joined, _carrying(setting, full[joined], joined)


def _carrying(setting: InteriorSetting, weights: Array, active: Index) -> Array:
    """Weights with what they lack to the size, spread over the room left."""
    room = setting.caps[active] - weights
    return np.asarray(weights + (setting.size - weights.sum()) * room / room.sum())
