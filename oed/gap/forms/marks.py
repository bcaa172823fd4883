"""The marks of a scale, the poles of a motor: waves along a joint's travel far finer
than its readings lie apart.

What a joint was sent to is known exactly, so readings at uneven places see fine waves
as well as dense ones. Their phases at two readings have nothing to do with each other:
the inner product of such a wave with itself is that of each reading alone, M_ii summed,
and what every frequency explains of the residual r is one Fourier transform of M r
along the travel. The strongest few are looked at closely.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from oed.arrays import Array
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers, waves
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw

NAME = "fine marks along a joint"
#: what a travel is divided in for the transform, m, and in how many at most; shortest
#: period, in these
BIN, MOST, FINEST = 1e-6, 2**21, 8.0


def added(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """The processes with the strongest fine waves of each sliding joint, and of all of
    them, beside them.
    """
    long, place, spans = waves.travels(problem)
    if not long:
        return processes
    metric, legs = Metric(problem, law), carriers.joints(problem)
    size, bin_size = _division(float(place[:, :, long].max()))
    every = fft.rfftfreq(size, bin_size)
    some = np.flatnonzero(
        (every > 1.0 / waves.SHORT) & (every < 1.0 / (FINEST * bin_size))
    )
    energy = _energies(
        problem, metric, legs[:, long], place[:, :, long] / bin_size, size
    )[:, some]
    found, count = [], 0.0
    for own, leg in zip(energy, long, strict=True):
        found += waves.peaks(
            problem, metric, waves.along(legs, [leg], place, every[some]), own[None]
        )
        count += spans[leg] * float(np.ptp(every[some]))
    if len(long) > 1:
        together = energy.sum(axis=0)[None]
        found += waves.peaks(
            problem, metric, waves.along(legs, long, place, every[some]), together
        )
        count += float(spans[long].max() * np.ptp(every[some]))
    return carriers.beside(
        processes, NAME, [(found, int(waves.OVER * count) + 1)], waves.KEPT
    )


def _division(travel: float) -> tuple[int, float]:
    """Length of a transform that has two frequencies a period in the travel, and the
    bins (m) of its places.
    """
    bin_size = max(BIN, travel / MOST)
    return int(2 ** math.ceil(math.log2(2.0 * travel / bin_size + 2.0))), bin_size


def _energies(
    problem: GapProblem, metric: Metric, legs: Array, place: Array, size: int
) -> Array:
    """What a wave of each frequency explains of the residual on each of L carriers (N,
    L, J), at places (N, J, L) in bins: (L, frequencies).
    """
    (white, absorbed), (r0, r1) = (
        metric.parts(np.eye(len(problem))),
        metric.parts(problem.residual[:, None]),
    )
    told = white.T @ r0 - absorbed.T @ r1
    weight = (white**2).sum(axis=0) - (absorbed**2).sum(axis=0)
    made = []
    for k in range(legs.shape[1]):
        carrier, low = told * legs[:, k], np.floor(place[:, :, k])
        over, at = place[:, :, k] - low, low.astype(np.intp).ravel()
        binned = np.bincount(at, ((1.0 - over) * carrier).ravel(), size)
        binned += np.bincount(at + 1, (over * carrier).ravel(), size)
        own = 0.5 * float((weight[:, None] * legs[:, k] ** 2).sum())
        made.append(np.abs(fft.rfft(binned)) ** 2 / max(own, 1e-300))
    return np.array(made)
