"""Fine marks along a joint, such as a scale's: waves finer than its readings lie apart.

What a joint was sent to is known exactly, so that readings at uneven places see fine
waves as well as dense ones do. The phases of such a wave at two readings are unrelated:
its inner product with itself is that of each reading alone, M_ii summed, and what every
frequency explains of the residual r is one Fourier transform of M r along the travel.
The strongest few are refined.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from oed.arrays import Array
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import bands, carriers, waves
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw

NAME = "fine marks along a joint"
#: width of the bins that a travel is divided in for the transform, m, and the most of
#: them; shortest period, in bins
BIN, MOST, FINEST = 1e-6, 2**21, 8.0


def add(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """Processes together with the strongest fine waves of the sliding joints.

    Waves of each joint alone, and of all joints at one period.
    """
    sliding, place, spans = bands.travels(problem)
    if not sliding:
        return processes
    metric, legs = Metric(problem, law), carriers.joint_carriers(problem)
    travel = place[:, :, sliding]
    size, bin_size = _division(float(travel.max()))
    frequencies = fft.rfftfreq(size, bin_size)
    long_enough = frequencies < 1.0 / (FINEST * bin_size)
    fine = np.flatnonzero((frequencies > 1.0 / bands.SHORT) & long_enough)
    frequencies = frequencies[fine]
    width = np.ptp(frequencies)
    energy = _energies(problem, metric, legs[:, sliding], travel / bin_size, size)
    energy = energy[:, fine]
    peaks, cells = [], 0.0
    for strength, leg in zip(energy, sliding, strict=True):
        band = bands.travel_band(legs, [leg], place, frequencies)
        peaks += waves.peaks(problem, metric, band, strength[None])
        cells += spans[leg] * float(width)
    if len(sliding) > 1:
        band = bands.travel_band(legs, sliding, place, frequencies)
        peaks += waves.peaks(problem, metric, band, energy.sum(axis=0)[None])
        cells += float(spans[sliding].max() * width)
    tried = int(bands.OVER * cells) + 1
    return carriers.add_peaks(processes, NAME, [(peaks, tried)], waves.PEAKS)


def _division(travel: float) -> tuple[int, float]:
    """Length of a transform with two frequencies a period in the travel, and its bins.

    The width of the bins is in m.
    """
    bin_size = max(BIN, travel / MOST)
    places = 2.0 * travel / bin_size + 2.0
    return int(2 ** math.ceil(math.log2(places))), bin_size


def _energies(
    problem: GapProblem,
    metric: Metric,
    legs: Array,
    place: Array,
    size: int,
) -> Array:
    """What a wave of each frequency explains of the residual: (L, frequencies).

    legs     (N, L, J) the carriers
    place    (N, J, L) their places, in bins
    size     length of the transform
    """
    white, absorbed = metric.parts(np.eye(len(problem)))
    r0, r1 = metric.parts(problem.residual[:, None])
    weighted_residual = white.T @ r0 - absorbed.T @ r1
    weight = (white**2).sum(axis=0) - (absorbed**2).sum(axis=0)
    energies = []
    for k in range(legs.shape[1]):
        carrier = weighted_residual * legs[:, k]
        low = np.floor(place[:, :, k])
        share = place[:, :, k] - low
        at = low.astype(np.intp).ravel()
        binned = np.bincount(at, ((1.0 - share) * carrier).ravel(), size)
        binned += np.bincount(at + 1, (share * carrier).ravel(), size)
        norm = 0.5 * float((weight[:, None] * legs[:, k] ** 2).sum())
        power = np.abs(fft.rfft(binned)) ** 2
        energies.append(power / max(norm, 1e-300))
    return np.array(energies)
