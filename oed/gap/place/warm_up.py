"""Warm-up intervals of a tool that grows while it is heated: a deconvolution.

A tool grows while something heats it, such as a running spindle, and goes on shrinking
long after that has ended. Its length is no window of the session and does not show by
itself when the heat came. With a time constant tau,

    length(t) = sum_k h_k g(t; cell k),    g = 1 - exp(-(t - a) / tau) within [a, b],
                                           g(b) exp(-(t - b) / tau) after it.

Heat comes but does not go by itself: h >= 0, or <= 0 throughout where something is
cooled. Non-negative least squares (Lawson and Hanson 1974) fits it, with a weak prior
that all cells are equally likely small. The stretches of cells with heat are the
warm-up intervals.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import optimize

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.gap.place import session

#: cells of the session, time constants that are tried, s
CELLS, CONSTANTS = 24, (300.0, 600.0, 1000.0, 2000.0, 4000.0)
#: weight of the prior, against an average cell's change; heat below which a cell has
#: none, against the hottest
RIDGE, LEAST = 0.5, 0.1
#: energy that heat must explain beyond a plain window
WORTH = 8.0


@dataclasses.dataclass(frozen=True, slots=True)
class WarmUp:
    """A stretch of the session in which the tool was warmed.

    first, last    its ends, s
    energy         that it explains by itself
    """

    first: float
    last: float
    energy: float


def intervals(
    problem: GapProblem,
    scores: Callable[[Array], Array],
    by_window: float,
) -> list[WarmUp]:
    """Warm-up intervals of the tool, the one that explains most first.

    None where they explain no more than the energy `by_window` of a plain window.
    `scores` takes readings (N, k) to where the metric is the identity.
    """
    times = session.clock(problem)
    begin, end = float(np.nanmin(times)), float(np.nanmax(times))
    edges = np.linspace(begin, end, CELLS + 1)
    residual = scores(problem.residual)
    fits = [_fit_heat(problem, scores, residual, edges, tau) for tau in CONSTANTS]
    explained, heat, growth = max(fits, key=lambda fit: fit[0])
    if explained < by_window + WORTH:
        return []
    warm = heat > LEAST * heat.max()
    hot = np.concatenate([[False], warm, [False]])
    begins = np.flatnonzero(hot[1:] & ~hot[:-1])
    ends = np.flatnonzero(~hot[1:] & hot[:-1])
    stretches = []
    for a, b in zip(begins, ends, strict=True):
        change = growth[:, a:b] @ heat[a:b]
        energy = float(change @ change)
        stretches.append(WarmUp(float(edges[a]), float(edges[b]), energy))
    return sorted(stretches, key=lambda interval: -interval.energy)


def _fit_heat(
    problem: GapProblem,
    scores: Callable[[Array], Array],
    residual: Array,
    edges: Array,
    tau: float,
) -> tuple[float, Array, Array]:
    """Fit of the heat with one time constant.

    Energy that it explains less the prior's part, heat (CELLS,), and each cell's change
    of the readings (N, CELLS).
    """
    first, last = edges[:-1], edges[1:]
    shares = [response(s.time, first, last, tau) for s in problem.states]
    growth = scores(session.tool_growth(problem, shares))
    size = float(np.linalg.norm(growth, axis=0).mean())
    if size == 0.0:
        return 0.0, np.zeros(CELLS), growth
    growth = growth / size
    target = np.concatenate([residual, np.zeros(CELLS)])
    prior = RIDGE * np.eye(CELLS)
    fits = []
    for sign in (1.0, -1.0):
        design = np.vstack([sign * growth, prior])
        heat, misfit = optimize.nnls(design, target, maxiter=100 * CELLS)
        explained = float(residual @ residual - misfit**2)
        fits.append((explained, heat, sign * growth))
    return max(fits, key=lambda fit: fit[0])


def response(time: Array, first: Array, last: Array, tau: float) -> Array:
    """Length (m, k) at times (m,), per length in the long run, of a warmed tool.

    It is warmed from `first` to `last` (k,), s; 0 where the time is not known.
    """
    duration = last - first
    since = np.nan_to_num(time, nan=-np.inf)[:, None] - first
    grown = -np.expm1(-np.clip(since, 0.0, duration) / tau)
    after = np.clip(since - duration, 0.0, None)
    return np.asarray(grown * np.exp(-after / tau))
