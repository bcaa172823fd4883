"""Steady waves of unknown frequency, as unknown processes.

A wave may run in time (interference, a pump), along the path at one feed (a resonance),
or along a joint's travel (a gear). Its period may be anything from the session or a run
to two readings. Of all frequencies (Lomb's periodogram, in the metric that lets the
parameters absorb first) the strongest few stay, each with the prior weight of one among
all that were tried.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import signal

from oed import units
from oed.arrays import Array
from oed.gap.data import evidence
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import bands, carriers
from oed.gap.forms.bands import OVER, Band
from oed.gap.forms.carriers import Peak
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw

NAME = "a steady wave"
#: peaks of each kind, and of waves of many columns, that stay
PEAKS, BEST = 4, 2
#: frequencies that are computed at once
CHUNK = 512
#: evenly spaced frequencies from which on their waves are products of fewer waves
MANY = 64
#: frequencies that go with one at a peak: it may be that of the fundamental wave or of
#: its overtone
TONES = (0.5, 1.0, 2.0)
#: sizes that waves of many columns are tried with
SIZES = np.array([0.1, 0.3, 1.0, 3.0])


def add(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """Processes together with the strongest steady waves of each kind.

    Each kind has the prior weight of a process.
    """
    metric = Metric(problem, law)
    kinds: list[tuple[list[Peak], int]] = []
    for kind in bands.bands_by_kind(problem):
        kind_peaks = []
        for band in kind:
            kind_peaks += peaks(
                problem, metric, band, -_log_tails(problem, metric, band)
            )
        tried = sum(len(band.frequencies) * len(band.carriers) for band in kind)
        kinds.append((kind_peaks, tried))
    for kind in (bands.swing_bands(problem), bands.run_bands(problem)):
        tried = sum(len(band.frequencies) for band in kind)
        kinds.append((_peaks_by_evidence(problem, metric, kind), tried))
    found_kinds = [kind for kind in kinds if kind[0]]
    return carriers.add_peaks(processes, NAME, found_kinds, PEAKS)


def peaks(
    problem: GapProblem,
    metric: Metric,
    band: Band,
    strength: Array,
) -> list[Peak]:
    """The strongest waves of a band on each of its carriers, refined in frequency.

    `strength` (carriers, k) ranks the band's frequencies.
    """
    strongest = []
    sources = zip(band.carriers, band.names, strength, strict=True)
    for carrier, name, height in sources:
        padded = np.concatenate([[-1.0], height, [-1.0]])
        maxima, _ = signal.find_peaks(padded, distance=int(2 * OVER))
        order = np.argsort(-height[maxima - 1])[:PEAKS]
        for k in maxima[order] - 1:
            near = band.refined(carrier, int(k))
            tails = _log_tails(problem, metric, near)[0]
            frequency = float(near.frequencies[np.argmin(tails)])
            log_tail = float(tails.min())
            strongest.append(_peak(band, carrier, name, frequency, log_tail))
    return strongest


def _peak(
    band: Band,
    carrier: Array,
    name: str,
    frequency: float,
    log_tail: float,
) -> Peak:
    """A wave with its half and its double frequency, alone or in pairs."""
    tones = []
    for factor in TONES:
        both = _cosine_and_sine(band.clock, np.array([factor * frequency]))
        tones.append(_waves(carrier, both)[:, :, 0])
    columns = np.hstack(tones)
    half, single, double = np.arange(columns.shape[1]).reshape(3, -1)
    fundamental = np.concatenate([single, double])
    overtone = np.concatenate([half, single])
    period = 1.0 / frequency
    return Peak(
        log_tail=log_tail,
        columns=columns,
        constants={f"period_{band.unit}": period},
        about=_in_words(band.unit, period, name),
        forms=(single, fundamental, overtone),
        labels=tuple(leg for _ in TONES for leg in band.legs for _ in range(2)),
    )


def _peaks_by_evidence(
    problem: GapProblem,
    metric: Metric,
    bands: Sequence[Band],
) -> list[Peak]:
    """The best waves of bands whose carriers have many columns, few of them seen well.

    Their evidence ranks them, for what all of them explain is mostly noise.
    """
    candidates = []
    for band in bands:
        both = _cosine_and_sine(band.clock, band.frequencies)
        columns = _waves(band.carriers[0], both)
        width, name = columns.shape[1], band.names[0]
        by_frequency = columns.transpose(0, 2, 1).reshape(len(problem), -1)
        whitened = evidence.WhitenedColumns(problem, metric, by_frequency)
        for k, frequency in enumerate(band.frequencies):
            grams = whitened.grams(slice(k * width, (k + 1) * width))
            log_evidence = grams.log_evidences([np.arange(width)], SIZES)
            period = 1.0 / float(frequency)
            peak = Peak(
                log_tail=-float(log_evidence.max()),
                columns=columns[:, :, k],
                constants={f"period_{band.unit}": period},
                about=_in_words(band.unit, period, name),
            )
            candidates.append(peak)
    return sorted(candidates, key=lambda p: p.log_tail)[:BEST]


def _in_words(unit: str, period: float, name: str) -> str:
    """A wave in words, its period in a unit of usual size."""
    if unit == "s":
        size, word = _unit_of_time(period)
        return f"{name} in a wave of {period / size:.3g} {word}"
    if unit == "readings":
        return f"{name} in a wave of {period:.3g} readings"
    clock = "path" if unit == "m" else "travel"
    millimetres = units.number(period, "mm")
    return f"{name} in a wave every {millimetres:.3g} mm of {clock}"


def _unit_of_time(period: float) -> tuple[float, str]:
    """The largest unit of which a period has more than two, in s and by name."""
    for unit in ("h", "min"):
        if period > 2.0 * units.factor(unit):
            return units.factor(unit), unit
    return 1.0, "s"


def _cosine_and_sine(clock: Array, frequencies: Array) -> Array:
    """Cosine and sine (..., 2, k) of each frequency at a clock (...)."""
    phase = 2.0 * np.pi * clock[..., None]
    if not _many_even(frequencies):
        angle = phase * frequencies
        return np.stack([np.cos(angle), np.sin(angle)], axis=-2)
    # exp(i (a + b)) = exp(i a) exp(i b): a product costs less than a cosine
    count = len(frequencies)
    width = math.isqrt(count)
    coarse = np.exp(1j * phase * frequencies[::width])
    fine = np.exp(1j * phase * (frequencies[:width] - frequencies[0]))
    turns = coarse[..., :, None] * fine[..., None, :]
    turns = turns.reshape(*clock.shape, -1)[..., :count]
    return np.stack([turns.real, turns.imag], axis=-2)


def _many_even(frequencies: Array) -> bool:
    """Whether frequencies are many, and evenly spaced."""
    if len(frequencies) < MANY:
        return False
    steps = np.diff(frequencies)
    return bool(np.ptp(steps) <= 1e-9 * steps.mean())


def _waves(carrier: Array, both: Array) -> Array:
    """Columns (N, 2 c, k) of waves on each column of a carrier (N, c, J).

    `both` are cosines and sines (N, J, 2, k), or (N, J, c, 2, k) of each column's own
    clock.
    """
    if both.ndim == 5:
        columns = np.einsum("ncj,njchk->nchk", carrier, both)
    else:
        flat = both.reshape(*both.shape[:2], -1)
        columns = carriers.apply_carrier(carrier, flat)
    return np.asarray(columns.reshape(len(carrier), -1, both.shape[-1]))


def _log_tails(problem: GapProblem, metric: Metric, band: Band) -> Array:
    """Log tail probability (carriers, k) of what each wave explains, its phases free."""
    residual = metric.parts(problem.residual[:, None])
    tails = np.empty((len(band.carriers), len(band.frequencies)))
    for start in range(0, tails.shape[1], CHUNK):
        chunk = slice(start, start + CHUNK)
        both = _cosine_and_sine(band.clock, band.frequencies[chunk])
        for row, carrier in zip(tails, band.carriers, strict=True):
            waves = _waves(carrier, both)
            row[chunk] = carriers.log_tails(metric, waves, residual)
    return tails
