"""A fault at a place of the workspace, as an unknown process: a bump about any place
that the tool comes to.

A table that gives way, a cover that rubs, a wrong cell of a compensation table. Where
is anybody's guess: bumps about places spread over all that were read are looked at, and
those about the best ones once more about their neighbours.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers
from oed.gap.forms.carriers import Peak
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw

NAME = "at a place"
#: places that are looked at; widths of the bumps, as shares of the longest way across
#: all places; those of a close look
PLACES, WIDTHS, FINE = 48, (0.12, 0.24), (0.09, 0.12, 0.17, 0.24, 0.34)
#: best places of each carrier that are looked at closely, and best bumps of all that
#: are kept
CLOSE, KEPT = 2, 6
#: distance between places, as a share of the longest way, below which they are one
SAME = 0.02


def added(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """The processes with the strongest bumps beside them."""
    metric, at = (
        Metric(problem, law),
        carriers.at_poses(problem, [s.tool for s in problem.states]),
    )
    reach = float(np.ptp(at[:, 0], axis=0).max())
    if reach <= 0.0:
        return processes
    spread = _spread(at[:, 0] / reach)
    residual = metric.parts(problem.residual[:, None])
    every = carriers.every(problem)
    found = []
    for on, carrier in zip(carriers.named(problem), every, strict=True):
        for peak in _peaks(metric, at / reach, spread, carrier, residual):
            place = ", ".join(
                f"{1e3 * reach * peak.constants[axis]:.0f}" for axis in "xyz"
            )
            found.append(
                dataclasses.replace(peak, about=f"{on} about the place {place} mm")
            )
    return carriers.beside(
        processes, NAME, [(found, len(spread) * len(WIDTHS) * len(every))], KEPT
    )


def _spread(at: Array) -> Array:
    """Places (k, 3) far from each other among all (N, 3), the next always the farthest
    from those before.
    """
    chosen = [int(np.argmax(((at - at.mean(axis=0)) ** 2).sum(axis=1)))]
    away = np.linalg.norm(at - at[chosen[0]], axis=1)
    while len(chosen) < PLACES and away.max() > SAME:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(at - at[chosen[-1]], axis=1))
    return np.asarray(at[chosen])


def _bumps(at: Array, centres: Array, widths: tuple[float, ...]) -> Array:
    """Bumps (N, J, k) of each width about each centre, centre by centre, at places (N,
    J, 3).
    """
    away = ((at[:, :, None] - centres) ** 2).sum(axis=3)
    return np.asarray(
        np.exp(-0.5 * away[..., None] / np.square(widths)).reshape(*at.shape[:2], -1)
    )


def _peaks(
    metric: Metric,
    at: Array,
    spread: Array,
    carrier: Array,
    residual: tuple[Array, Array],
) -> list[Peak]:
    """The strongest bumps on one carrier (N, c, J)."""
    coarse = carriers.tails(
        metric, carriers.acting(carrier, _bumps(at, spread, WIDTHS)), residual
    )
    best = np.argsort(coarse.reshape(len(spread), -1).min(axis=1))[:CLOSE]
    spacing = max(
        float(np.sort(np.linalg.norm(spread - spread[k], axis=1))[:4][-1]) for k in best
    )
    found, read = [], at[:, 0]
    for k in best:
        near = np.unique(
            np.round(read[np.linalg.norm(read - spread[k], axis=1) <= spacing], 6),
            axis=0,
        )
        near = near[np.linspace(0, len(near) - 1, min(len(near), PLACES)).astype(int)]
        bumps = carriers.acting(carrier, _bumps(at, near, FINE))
        tails = carriers.tails(metric, bumps, residual)
        first = int(np.argmin(tails))
        place = near[first // len(FINE)]
        constants = {
            **dict(zip("xyz", map(float, place), strict=True)),
            "width": FINE[first % len(FINE)],
        }
        found.append(Peak(float(tails[first]), bumps[:, :, first], constants, ""))
    return found
