"""Local errors of the workspace, as unknown processes: a bump about any place.

A table that gives way, a cover that rubs, a wrong cell of a compensation table: such a
place may be anywhere that the tool comes to. Bumps about places spread over all that
were read are tried first, then bumps about the neighbours of the best ones.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed import units
from oed.arrays import Array
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers
from oed.gap.forms.carriers import Peak
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw

NAME = "at a place"
#: places that are tried
PLACES = 48
#: widths of the bumps, as shares of the longest way across all places: of those tried
#: first, and of the refined ones
WIDTHS = (0.12, 0.24)
FINE = (0.09, 0.12, 0.17, 0.24, 0.34)
#: best places of each carrier that are refined, and best bumps of all that stay
REFINED, BEST = 2, 6
#: distance between places, as a share of the longest way, below which they are one
SAME = 0.02


def add(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """Processes together with the strongest bumps."""
    metric = Metric(problem, law)
    at = carriers.at_poses(problem, [s.tool for s in problem.states])
    reach = float(np.ptp(at[:, 0], axis=0).max())
    if reach <= 0.0:
        return processes
    centres = _spread(at[:, 0] / reach)
    residual = metric.parts(problem.residual[:, None])
    every = carriers.all_carriers(problem)
    names = carriers.carrier_names(problem)
    peaks = []
    for name, carrier in zip(names, every, strict=True):
        for peak in _peaks(metric, at / reach, centres, carrier, residual):
            about = f"{name} about the place {_place_in_words(peak, reach)}"
            peaks.append(dataclasses.replace(peak, about=about))
    tried = len(centres) * len(WIDTHS) * len(every)
    return carriers.add_peaks(processes, NAME, [(peaks, tried)], BEST)


def _place_in_words(peak: Peak, reach: float) -> str:
    coordinates = [reach * peak.constants[axis] for axis in "xyz"]
    return ", ".join(f"{units.number(c, 'mm'):.0f}" for c in coordinates) + " mm"


def _spread(at: Array) -> Array:
    """Places (k, 3) far from each other among all (N, 3).

    The next one is always the farthest from those before.
    """
    offset = at - at.mean(axis=0)
    from_middle = (offset**2).sum(axis=1)
    chosen = [int(np.argmax(from_middle))]
    distance = np.linalg.norm(at - at[chosen[0]], axis=1)
    while len(chosen) < PLACES and distance.max() > SAME:
        chosen.append(int(np.argmax(distance)))
        to_last = np.linalg.norm(at - at[chosen[-1]], axis=1)
        distance = np.minimum(distance, to_last)
    return np.asarray(at[chosen])


def _bumps(at: Array, centres: Array, widths: tuple[float, ...]) -> Array:
    """Bumps (N, J, k) of each width about each centre, at places (N, J, 3).

    Columns run centre by centre.
    """
    offset = at[:, :, None] - centres
    squared = (offset**2).sum(axis=3)[..., None]
    bumps = np.exp(-0.5 * squared / np.square(widths))
    return np.asarray(bumps.reshape(*at.shape[:2], -1))


def _peaks(
    metric: Metric,
    at: Array,
    centres: Array,
    carrier: Array,
    residual: tuple[Array, Array],
) -> list[Peak]:
    """The strongest bumps on one carrier (N, c, J), refined in place and width."""
    coarse = carriers.apply_carrier(carrier, _bumps(at, centres, WIDTHS))
    tails = carriers.log_tails(metric, coarse, residual)
    by_centre = tails.reshape(len(centres), -1).min(axis=1)
    best = np.argsort(by_centre)[:REFINED]
    spacing = max(_spacing(centres, int(k)) for k in best)
    strongest = []
    for k in best:
        near = _neighbours(at[:, 0], centres[k], spacing)
        bumps = carriers.apply_carrier(carrier, _bumps(at, near, FINE))
        tails = carriers.log_tails(metric, bumps, residual)
        first = int(np.argmin(tails))
        x, y, z = map(float, near[first // len(FINE)])
        width = FINE[first % len(FINE)]
        constants = {"x": x, "y": y, "z": z, "width": width}
        peak = Peak(float(tails[first]), bumps[:, :, first], constants, "")
        strongest.append(peak)
    return strongest


def _spacing(centres: Array, k: int) -> float:
    """Distance from a centre to the third nearest of the others, or to the last."""
    distances = np.linalg.norm(centres - centres[k], axis=1)
    return float(np.sort(distances)[:4][-1])


def _neighbours(places: Array, centre: Array, spacing: float) -> Array:
    """Distinct places (k, 3) that were read within a distance of a centre."""
    close = np.linalg.norm(places - centre, axis=1) <= spacing
    near = np.unique(np.round(places[close], 6), axis=0)
    last, count = len(near) - 1, min(len(near), PLACES)
    chosen = np.linspace(0, last, count).astype(int)
    return np.asarray(near[chosen])
