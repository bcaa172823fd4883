"""When a tool that is longer for a while was warmed: a deconvolution.

A tool grows while something heats it, a spindle that runs, and goes on shrinking long
after that has ended: its length is no window of the session, nor does it tell at sight
when the heat came. With a time constant tau,

    length(t) = sum_k h_k g(t; cell k),    g = 1 - exp(-(t - a) / tau) within [a, b],
                                           g(b) exp(-(t - b) / tau) after it,

and heat that comes but does not go by itself: h >= 0 (or <= 0 throughout, where
something is cooled), found by least squares with a weak prior that all cells are as
likely small (non-negative least squares, Lawson and Hanson 1974). The stretches of
cells with heat are when it came.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import optimize

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.gap.place import regions as looks

#: cells of the session, time constants that are tried, s
CELLS, CONSTANTS = 24, (300.0, 600.0, 1000.0, 2000.0, 4000.0)
#: weight of the prior, against an average cell's change; heat below which a cell has
#: none, against the hottest
RIDGE, LEAST = 0.5, 0.1
#: energy that heat must explain beyond a plain window
WORTH = 8.0


@dataclasses.dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of the session, s, in which the tool was warmed, and the energy that it
    explains by itself.
    """

    first: float
    last: float
    energy: float


def stretches(
    problem: GapProblem, scores: Callable[[Array], Array], plain: float
) -> list[Stretch]:
    """When the tool was warmed, the stretch that explains most first; none where they
    explain no more than the energy `plain` of a window. `scores` takes readings (N, k)
    to where the metric is the identity.
    """
    clock = looks.clock_of(problem)
    edges = np.linspace(float(np.nanmin(clock)), float(np.nanmax(clock)), CELLS + 1)
    residual = scores(problem.residual)
    worth, heat, grown = max(
        (_heat(problem, scores, residual, edges, tau) for tau in CONSTANTS),
        key=lambda f: f[0],
    )
    if worth < plain + WORTH:
        return []
    hot = np.concatenate([[False], heat > LEAST * heat.max(), [False]])
    found = []
    for a, b in zip(
        np.flatnonzero(hot[1:] & ~hot[:-1]),
        np.flatnonzero(~hot[1:] & hot[:-1]),
        strict=True,
    ):
        made = grown[:, a:b] @ heat[a:b]
        found.append(Stretch(float(edges[a]), float(edges[b]), float(made @ made)))
    return sorted(found, key=lambda s: -s.energy)


def _heat(
    problem: GapProblem,
    scores: Callable[[Array], Array],
    residual: Array,
    edges: Array,
    tau: float,
) -> tuple[float, Array, Array]:
    """What heat with one time constant explains, less the prior's part; heat (CELLS,)
    and what each cell's makes of the readings (N, CELLS).
    """
    shares = [response(s.time, edges[:-1], edges[1:], tau) for s in problem.states]
    grown = scores(looks.lengthened(problem, shares))
    size = float(np.linalg.norm(grown, axis=0).mean())
    if size == 0.0:
        return 0.0, np.zeros(CELLS), grown
    grown = grown / size
    zeros, prior = np.zeros(CELLS), RIDGE * np.eye(CELLS)
    tried = []
    for sign in (1.0, -1.0):
        heat, left = optimize.nnls(
            np.vstack([sign * grown, prior]),
            np.concatenate([residual, zeros]),
            maxiter=100 * CELLS,
        )
        tried.append((float(residual @ residual - left**2), heat, sign * grown))
    return max(tried, key=lambda t: t[0])


def response(time: Array, first: Array, last: Array, tau: float) -> Array:
    """Length (m, k) at times (m,), per length in the long run, of what is warmed from
    `first` to `last` (k,), s; none where the time is not known.
    """
    since = np.nan_to_num(time, nan=-np.inf)[:, None] - first
    risen = -np.expm1(-np.clip(since, 0.0, last - first) / tau)
    return np.asarray(risen * np.exp(-np.clip(since - (last - first), 0.0, None) / tau))
