"""Steady waves of unknown frequency: the discrepancy's terms with a period.

A wave may run in time (interference, a pump) or along a joint's travel (a gear). Its
period may be anything from the session or the travel to two readings. Of all
frequencies (Lomb's periodogram, in the metric that lets the parameters absorb first)
the strongest few stay, each with the prior weight of one among all that were tried.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
import scipy
from scipy import special

from oed import units
from oed.base import Array
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import discrepancy as discrepancies
from oed.gap.forms.discrepancy import JOINTS, Carrier
from oed.gap.forms.library import Atom, Library
from oed.noise import NoiseLaw

#: kinds of waves
IN_TIME = "a wave in time"
ALONG_TRAVEL = "a wave along the travel"
#: waves of each kind that stay
N_PEAKS = 4
#: frequencies a resolution cell
OVERSAMPLING = 1.5
#: frequencies of a band, at most
MAX_FREQUENCIES = 6000
#: values that are computed at once: of many readings fewer frequencies. There are some
#: twenty arrays of as many: more take memory and no less time
VALUES_AT_ONCE = 250_000
#: shortest period, in steps between readings, where these are irregular: they
#: distinguish waves from their aliases
IRREGULAR_PERIOD = 0.25
#: longest period along a joint's travel as a share of it
MAX_PERIOD = 3.0
#: readings that a clock must have for its waves to mean something
MIN_TICKS = 16
#: places between two frequencies at which a peak is refined
REFINED_STEPS = np.linspace(-0.8, 0.8, 9)


@dataclasses.dataclass(frozen=True, slots=True)
class Band:
    """Waves of some frequencies over a clock.

    kind           in time, or along a travel
    unit           of the clock: s, readings, travel_m or travel_rad
    clock          (N, J) at each of the poses that a reading sees
    carriers       what one of them may act on
    frequencies    (k,) per unit of the clock, evenly spaced
    """

    kind: str
    unit: str
    clock: Array
    carriers: tuple[Carrier, ...]
    frequencies: Array


@dataclasses.dataclass(frozen=True, slots=True)
class Wave:
    """A wave that explains much of the residual, and the log tail probability of it."""

    band: Band
    carrier: Carrier
    frequency: float
    log_tail: float


def add(discrepancy: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """The discrepancy together with the strongest steady waves of each kind.

    Each kind has the prior weight of a kind of discrepancy.
    """
    metric = Metric(problem, law)
    by_kind: dict[str, list[Band]] = {}
    _, *others = discrepancies.carriers_of(problem)
    legs = next(carrier for carrier in others if carrier.name == JOINTS).parts()
    for band in [*_time_bands(problem, others), *_travel_bands(problem, legs)]:
        by_kind.setdefault(band.kind, []).append(band)
    for kind, bands in by_kind.items():
        waves = [wave for band in bands for wave in peaks(problem, metric, band)]
        tried = sum(len(band.frequencies) * len(band.carriers) for band in bands)
        strongest = sorted(waves, key=lambda w: w.log_tail)[:N_PEAKS]
        discrepancy = _joined(discrepancy, kind, strongest, -math.log(tried))
    return discrepancy


def _joined(
    library: Library, kind: str, waves: list[Wave], log_weight: float
) -> Library:
    """A library with waves as further atoms of a kind."""
    columns, atoms = [library.columns], list(library.atoms)
    labels = list(library.labels)
    for wave in waves:
        turns = _turns(wave.band.clock, np.array([wave.frequency]))
        block = _columns(wave.carrier, turns)[:, :, 0]
        columns_of_atom = len(labels) + np.arange(block.shape[1])
        period = 1.0 / wave.frequency
        constants = {f"period_{wave.band.unit}": period}
        about = _wave_words(wave.carrier.name, wave.band.unit, period)
        even, timed = np.ones(len(columns_of_atom)), kind == IN_TIME
        atoms.append(
            Atom(kind, constants, columns_of_atom, log_weight, about, timed, even)
        )
        columns.append(block)
        labels += [label for label in wave.carrier.labels for _ in range(2)]
    return discrepancies.assembled(columns, atoms, labels)


def peaks(problem: GapProblem, metric: Metric, band: Band) -> list[Wave]:
    """The strongest waves of a band on each of its carriers, refined in frequency."""
    step = float(np.ptp(band.frequencies[:2]))
    waves = []
    heights = -_log_tails(problem, metric, band)
    for carrier, height in zip(band.carriers, heights, strict=True):
        padded = np.concatenate([[-1.0], height, [-1.0]])
        maxima, _ = scipy.signal.find_peaks(padded, distance=int(2 * OVERSAMPLING))
        order = np.argsort(-height[maxima - 1])[:N_PEAKS]
        for k in maxima[order] - 1:
            fine = band.frequencies[k] + step * REFINED_STEPS
            near = dataclasses.replace(band, carriers=(carrier,), frequencies=fine)
            tails = _log_tails(problem, metric, near)[0]
            frequency = float(fine[np.argmin(tails)])
            waves.append(Wave(band, carrier, frequency, float(tails.min())))
    return waves


def _time_bands(problem: GapProblem, others: Sequence[Carrier]) -> Iterator[Band]:
    """Waves in time, or over the readings where not all times are known.

    They act on a channel, or on a part of the other carriers.
    """
    times = discrepancies.values_of_poses(problem, [s.time for s in problem.states])
    unit = "s"
    if not np.isfinite(times).all():
        number = discrepancies.values_of_poses(
            problem, [s.session_progress for s in problem.states]
        )
        readings = sum(len(series) for series in problem.series)
        unit, times = "readings", number * max(readings - 1, 1)
    clock = times - times.min()
    frequencies = _frequencies(clock[:, 0], 1.0)
    if not frequencies.size:
        return
    every = (discrepancies.channels(problem), *others)
    parts = tuple(part for carrier in every for part in carrier.parts())
    yield Band(IN_TIME, unit, clock, parts, frequencies)


def _travel_bands(problem: GapProblem, legs: Sequence[Carrier]) -> Iterator[Band]:
    """Waves of a joint along its own travel."""
    joints = discrepancies.values_of_poses(problem, [s.joints for s in problem.states])
    joints = joints - joints.min(axis=(0, 1))
    for i, joint in enumerate(problem.measurement.machine.joints):
        clock = joints[:, :, i]
        frequencies = _frequencies(clock[:, 0], MAX_PERIOD)
        if frequencies.size:
            unit = f"travel_{joint.unit}"
            yield Band(ALONG_TRAVEL, unit, clock, (legs[i],), frequencies)


def _frequencies(clock: Array, fewest: float) -> Array:
    """Frequencies (k,), so close that no wave over a clock (N,) falls between them.

    From `fewest` waves over all of it to what its steps can tell; none for a clock of
    few steps.
    """
    ticks = np.unique(np.round(clock, 9))
    if len(ticks) < MIN_TICKS:
        return np.zeros(0)
    span, step = float(np.ptp(ticks)), float(np.median(np.diff(ticks)))
    offsets = (ticks - ticks[0]) / step
    regular = np.abs(offsets - np.round(offsets)).max() <= 0.05
    shortest = (2.0 if regular else IRREGULAR_PERIOD) * step
    count = max(OVERSAMPLING * (span / shortest - fewest), 1.0)
    highest = min(1.0 / shortest, (fewest + MAX_FREQUENCIES / OVERSAMPLING) / span)
    return np.linspace(fewest / span, highest, int(min(count, MAX_FREQUENCIES)))


def _wave_words(name: str, unit: str, period: float) -> str:
    """A wave in words, its period in a unit of usual size."""
    if unit == "s":
        size, word = _unit_of_time(period)
        return f"{name} in a wave of {period / size:.3g} {word}"
    if unit == "readings":
        return f"{name} in a wave of {period:.3g} readings"
    unit = "deg" if unit == "travel_rad" else "mm"
    return f"{name} in a wave every {units.number(period, unit):.3g} {unit} of travel"


def _unit_of_time(period: float) -> tuple[float, str]:
    """The largest unit of which a period has more than two, in s and by name."""
    for unit in ("h", "min"):
        if period > 2.0 * units.factor(unit):
            return units.factor(unit), unit
    return 1.0, "s"


def _turns(clock: Array, frequencies: Array) -> Array:
    """Cosines, then sines (N, J, 2 k) of evenly spaced frequencies at a clock (N, J)."""
    count = len(frequencies)
    width = math.isqrt(count)
    phase = 2.0 * np.pi * clock[:, :, None]
    # exp(i (a + b)) = exp(i a) exp(i b): a product costs less than a cosine
    coarse = np.exp(1j * phase * frequencies[::width])
    fine = np.exp(1j * phase * (frequencies[:width] - frequencies[0]))
    turns = coarse[:, :, :, None] * fine[:, :, None, :]
    turns = turns.reshape(*clock.shape, -1)[:, :, :count]
    return np.concatenate([turns.real, turns.imag], axis=2)


def _columns(carrier: Carrier, turns: Array) -> Array:
    """Columns (N, 2 c, k) of cosines and sines (N, J, 2 k) on a carrier."""
    columns = discrepancies.apply_carrier(carrier.columns, turns)
    width = turns.shape[2] // 2
    return columns.reshape(len(columns), -1, width)


def _log_tails(problem: GapProblem, metric: Metric, band: Band) -> Array:
    """Log tail probability (carriers, k) of what each wave explains, its phases free."""
    residual = metric.parts(problem.residual[:, None])
    tails = np.empty((len(band.carriers), len(band.frequencies)))
    size = max(min(512, VALUES_AT_ONCE // len(problem)), 1)
    for start in range(0, tails.shape[1], size):
        chunk = slice(start, start + size)
        turns = _turns(band.clock, band.frequencies[chunk])
        for row, carrier in zip(tails, band.carriers, strict=True):
            row[chunk] = _tails_of(metric, _columns(carrier, turns), residual)
    return tails


def _tails_of(metric: Metric, forms: Array, residual: tuple[Array, Array]) -> Array:
    """Log tail probability (k,) of what forms (N, c, k) explain of a residual's parts."""
    size, width = forms.shape[1:]
    gram, b = np.zeros((width, size, size)), np.zeros((width, size))
    columns = metric.parts(forms.reshape(len(forms), -1))
    for sign, v, r in zip((1.0, -1.0), columns, residual, strict=True):
        part = v.reshape(-1, size, width)
        gram += sign * _grams(part)
        b += sign * np.einsum("nck,n->kc", part, r[:, 0])
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2) + 1e-300
    gram += ridge[:, None, None] * np.eye(size)
    solved = np.linalg.solve(gram, b[:, :, None])[:, :, 0]
    energy = np.einsum("fi,fi->f", b, solved)
    return log_tail(energy, size)


def _grams(forms: Array) -> Array:
    """Gram matrices (k, c, c) of forms (N, c, k), an entry of all of them at a time."""
    size, width = forms.shape[1:]
    grams = np.empty((width, size, size))
    for i in range(size):
        for j in range(i + 1):
            products = np.einsum("nk,nk->k", forms[:, i], forms[:, j])
            grams[:, i, j] = grams[:, j, i] = products
    return grams


# -- tail of the chi-square ------------------------------------------------------------


def log_tail(energy: Array, rank: Array | float) -> Array:
    """Log of the chi-square's upper tail; 0 for rank 0.

    Its asymptote stands in where the tail underflows.
    """
    a = np.maximum(rank, 1e-9) / 2.0
    x = np.maximum(energy, 0.0) / 2.0
    tail = special.gammaincc(a, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        correction = np.log1p((a - 1.0) / x)
        asymptote = -x + (a - 1.0) * np.log(x) - special.gammaln(a) + correction
        value = np.where(tail > 1e-280, np.log(tail), asymptote)
    return np.where(np.asarray(rank) == 0, 0.0, value)
