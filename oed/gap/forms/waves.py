"""Steady waves of unknown frequency: the discrepancy's terms with a period.

A wave may run in time (interference, a pump) or along a joint's travel (a gear). Its
period may be anything from the session or the travel to two readings. Of all
frequencies (Lomb's periodogram, in the metric that lets the parameters absorb first)
the strongest few stay, each with the prior weight of one among all that were tried.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
import scipy
from scipy import special

from oed import units
from oed.base import Array
from oed.gap.data.columns import Block, Columns
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import discrepancy as discrepancies
from oed.gap.forms.discrepancy import JOINTS, Carrier
from oed.gap.forms.library import Atom, Library
from oed.noise import NoiseLaw

IN_TIME = "a wave in time"  #: kinds of waves
ALONG_TRAVEL = "a wave along the travel"
N_PEAKS = 4  #: waves of each kind that stay
OVERSAMPLING = 1.5  #: frequencies a resolution cell
MAX_FREQUENCIES = 6000  #: frequencies of a band, at most
#: values that are computed at once, of many frequencies and a few readings: half of a
#: core's cache
VALUES_AT_ONCE = 60_000
ROW_VALUES = 12_000  #: those of one reading
#: places of the even grid, on either side of a reading, that its value goes to
SPREAD = 14
#: shortest period, in steps between readings, where these are irregular: they
#: distinguish waves from their aliases
IRREGULAR_PERIOD = 0.25
MAX_PERIOD = 3.0  #: longest period along a joint's travel as a share of it
MIN_TICKS = 16  #: readings that a clock must have for its waves to mean something
#: places between two frequencies at which a peak is refined
REFINED_STEPS = np.linspace(-0.8, 0.8, 9)


@dataclasses.dataclass(frozen=True, slots=True)
class Band:
    """Waves of some frequencies over a clock."""

    kind: str  #: in time, or along a travel
    unit: str  #: of the clock: s, readings, travel_m or travel_rad
    clock: Array  #: (N, J) at each of the poses that a reading sees
    carriers: tuple[Carrier, ...]  #: what one of them may act on
    frequencies: Array  #: (k,) per unit of the clock, evenly spaced


@dataclasses.dataclass(frozen=True, slots=True)
class Wave:
    """A wave that explains much of the residual, and the log tail probability of it."""

    band: Band
    carrier: Carrier
    frequency: float
    log_tail: float


def add(discrepancy: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """The discrepancy with the strongest steady waves of each kind, weighted as one."""
    precision = WavePrecision(problem, Metric(problem, law))
    by_kind: dict[str, list[Band]] = {}
    _, *others = discrepancies.carriers_of(problem)
    legs = next(carrier for carrier in others if carrier.name == JOINTS).parts()
    for band in _bands(problem, others, legs):
        by_kind.setdefault(band.kind, []).append(band)
    for kind, bands in by_kind.items():
        waves = [wave for band in bands for wave in peaks(precision, band)]
        tried = sum(len(band.frequencies) * len(band.carriers) for band in bands)
        strongest = sorted(waves, key=lambda w: w.log_tail)[:N_PEAKS]
        discrepancy = _joined(discrepancy, kind, strongest, -math.log(tried))
    return discrepancy


def _joined(
    library: Library, kind: str, waves: list[Wave], log_weight: float
) -> Library:
    """A library with waves as further atoms of a kind."""
    blocks: list[Block] = []
    atoms, labels = list(library.atoms), list(library.labels)
    for wave in waves:
        turns = _turns(wave.band.clock, np.array([wave.frequency]))
        block = _columns(wave.carrier.columns, turns)
        columns_of_atom = len(labels) + np.arange(block.shape[1])
        period = 1.0 / wave.frequency
        constants = {f"period_{wave.band.unit}": period}
        about = _wave_words(wave.carrier.name, wave.band.unit, period)
        even = np.ones(len(columns_of_atom))
        timed = kind == IN_TIME
        atoms.append(
            Atom(kind, constants, columns_of_atom, log_weight, about, timed, even)
        )
        blocks.append(Block.of(block))
        labels += [label for label in wave.carrier.labels for _ in range(2)]
    every = [*library.columns.blocks, *blocks]
    columns = Columns(len(library.columns), every)
    return Library(columns, tuple(atoms), tuple(labels))


def peaks(precision: "WavePrecision", band: Band) -> list[Wave]:
    """The strongest waves of a band on each of its carriers, refined in frequency."""
    step = float(np.ptp(band.frequencies[:2]))
    waves = []
    heights = -precision.log_tails(band)
    for carrier, height in zip(band.carriers, heights, strict=True):
        padded = np.concatenate([[-1.0], height, [-1.0]])
        maxima, _ = scipy.signal.find_peaks(padded, distance=int(2 * OVERSAMPLING))
        order = np.argsort(-height[maxima - 1])[:N_PEAKS]
        for k in maxima[order] - 1:
            fine = band.frequencies[k] + step * REFINED_STEPS
            near = dataclasses.replace(band, carriers=(carrier,), frequencies=fine)
            tails = precision.log_tails(near)[0]
            frequency = float(fine[np.argmin(tails)])
            waves.append(Wave(band, carrier, frequency, float(tails.min())))
    return waves


def _bands(
    problem: GapProblem, others: Sequence[Carrier], legs: Sequence[Carrier]
) -> Iterator[Band]:
    """Waves in time, or over the readings, of channels or parts of other carriers; and
    of each joint along its own travel.
    """
    times = discrepancies.values_of_poses(problem, [s.time for s in problem.states])
    unit = "s"
    if not np.isfinite(times).all():
        number = discrepancies.values_of_poses(
            problem, [s.session_progress for s in problem.states]
        )
        readings = sum(len(series) for series in problem.series)
        unit = "readings"
        times = number * max(readings - 1, 1)
    clock = times - times.min()
    frequencies = _frequencies(clock[:, 0], 1.0)
    if frequencies.size:
        every = (discrepancies.readings(problem, by_setup=False), *others)
        parts = tuple(part for carrier in every for part in carrier.parts())
        yield Band(IN_TIME, unit, clock, parts, frequencies)
    joints = discrepancies.values_of_poses(problem, [s.joints for s in problem.states])
    joints = joints - joints.min(axis=(0, 1))
    for i, joint in enumerate(problem.measurement.machine.joints):
        clock = joints[:, :, i]
        frequencies = _frequencies(clock[:, 0], MAX_PERIOD)
        if frequencies.size:
            unit = f"travel_{joint.unit}"
            yield Band(ALONG_TRAVEL, unit, clock, (legs[i],), frequencies)


def _frequencies(clock: Array, fewest: float) -> Array:
    """Frequencies (k,) from `fewest` waves to what a clock (N,) of many steps tells."""
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


class FourierSums:
    """Sums over readings of values times exp(2 pi i f t), at evenly spaced frequencies.

    Values go to a fine even grid by a Gaussian, whose transform is divided out (Greengard
    and Lee 2004, SIAM Rev. 46, 443-454): to 13 digits of the sum of their sizes.
    """

    def __init__(self, clock: Array, frequencies: Array) -> None:
        """Lay out the grid for clocks (N, J) and frequencies (k,)."""
        self._poses = clock.shape[1]
        count = len(frequencies)
        clock, self._grid = clock.reshape(-1, 1), None
        if count < 2 * SPREAD:  # so few sums cost less without a grid
            self._turns = np.exp(2j * np.pi * clock * frequencies)
            return
        size = scipy.fft.next_fast_len(2 * count)
        number = np.arange(count) - count // 2
        ratio, step = size / count, np.ptp(frequencies) / (count - 1)
        width = np.pi * SPREAD / (count**2 * ratio * (ratio - 0.5))
        place = np.mod(step * clock, 1.0) * size
        near = np.floor(place).astype(int) + np.arange(1 - SPREAD, SPREAD + 1)
        offset = (near - place) * (2.0 * np.pi / size)
        spread = np.exp(-(offset**2) / (4.0 * width))
        ends = np.arange(0, spread.size + 1, 2 * SPREAD)
        entries = spread.ravel(), near.ravel() % size, ends
        self._grid = scipy.sparse.csr_array(entries, shape=(len(clock), size))
        self._turns = np.exp(2j * np.pi * frequencies[count // 2] * clock)
        self._number = number % size
        self._factor = np.sqrt(np.pi / width) * np.exp(width * number**2)[:, None]

    def __call__(self, values: Array, first: int = 0) -> Array:
        """Sums (k, m) of values (n, J, m) at the readings from the first on."""
        flat = values.reshape(-1, values.shape[2])
        rows = slice(self._poses * first, self._poses * first + len(flat))
        if self._grid is None:
            return np.asarray(self._turns[rows].T @ flat)
        grid = self._grid[rows].T @ (flat * self._turns[rows])
        return np.asarray(self._factor * scipy.fft.ifft(grid, axis=0)[self._number])


class WavePrecision:
    """Products of waves in a metric, of all frequencies together.

    The precision of the noise with what parameters absorb is that of its white and
    correlated errors less A A^T of each run, and of the parameters. Products with A are
    Fourier sums.
    """

    def __init__(self, problem: GapProblem, metric: Metric) -> None:
        root = metric.root
        self._noise = root.alone
        white = root.remaining(root.whiten(problem.residual[:, None]))
        scored = self._noise.whiten_back_standard(white)
        #: columns (N, 1 + n): the residual times the precision, and A of the parameters
        self._common = np.hstack([scored, root.absorbed_root()])
        self._shared = self._noise.scored_root()
        starts = self._noise.errors.starts
        self._runs = list(map(slice, starts, [*starts[1:], len(scored)]))

    def log_tails(self, band: Band) -> Array:
        """Log tail probability (carriers, k) of what each wave explains, its phases free."""
        clock = band.clock[self._noise.order]
        sums = FourierSums(clock, band.frequencies)
        standardise = self._noise.errors.standardise
        weights = [
            np.stack([*map(standardise, carrier.columns.swapaxes(0, 1))], axis=1)
            for carrier in band.carriers
        ]
        numbers = 2 * sum(part.shape[1] for part in weights) * len(band.frequencies)
        chunks = np.array_split(band.frequencies, -(-numbers // ROW_VALUES))
        parts = [self._grams(weights, clock, chunk) for chunk in chunks]
        grams = map(np.concatenate, zip(*parts, strict=True))
        return np.array([*map(self._tails, itertools.repeat(sums), weights, grams)])

    def _tails(self, sums: FourierSums, weights: Array, gram: Array) -> Array:
        """The same (k,) of one carrier, of grams beside white and correlated errors alone."""
        along = self._along(sums, weights, self._common)
        taken = along[:, :, 1:]
        gram = gram - taken @ taken.swapaxes(1, 2)
        for run in self._runs if self._shared.any() else ():
            taken = self._along(sums, weights[run], self._shared[run], run.start)
            gram -= taken @ taken.swapaxes(1, 2)
        ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2) + 1e-300
        gram += ridge[:, None, None] * np.eye(gram.shape[1])
        energy = np.vecdot(
            along[:, :, 0], np.linalg.solve(gram, along[:, :, :1])[:, :, 0]
        )
        return log_tail(energy, gram.shape[1])

    def _along(
        self, sums: FourierSums, weights: Array, columns: Array, first: int = 0
    ) -> Array:
        """Products (k, 2 c, m) of waves of weights (n, c, J) with columns (n, m)."""
        values = weights.swapaxes(1, 2)[..., None] * columns[:, None, None]
        found = sums(values.reshape(*values.shape[:2], -1), first)
        found = found.reshape(len(found), *values.shape[2:])
        both = np.stack([found.real, found.imag], axis=2)
        return both.reshape(len(both), -1, columns.shape[1])

    def _grams(
        self, weights: Sequence[Array], clock: Array, frequencies: Array
    ) -> list[Array]:
        """Gram matrices (k, 2 c, 2 c) of each weights (N, c, J), beside white and
        correlated errors alone.
        """
        count, every = len(frequencies), np.concatenate(weights, axis=1)
        step = max(VALUES_AT_ONCE // (2 * every.shape[1] * count), 1)
        rows = [slice(k, k + step) for k in range(0, len(clock), step)]
        waves = (_columns(every[r], _turns(clock[r], frequencies)) for r in rows)
        grams = [np.zeros((2 * w.shape[1], 2 * w.shape[1], count)) for w in weights]
        ends = np.cumsum([len(gram) for gram in grams])[:-1]
        pairs = [list(zip(*np.tril_indices(len(gram)), strict=True)) for gram in grams]
        whitened = self._noise.banded.whiten_in_turn(waves)
        if count < 2 * SPREAD:  # rows are short
            whitened = iter([self._noise.banded.whiten(np.vstack(list(waves)))])
        for white in whitened:
            forms = np.split(white.reshape(len(white), -1, count), ends, axis=1)
            for gram, form, numbers in zip(grams, forms, pairs, strict=True):
                for i, j in numbers:
                    gram[i, j] += np.einsum("nk,nk->k", form[:, i], form[:, j])
        lower = [gram.transpose(2, 0, 1) for gram in grams]
        return [np.tril(part) + np.tril(part, -1).swapaxes(1, 2) for part in lower]


def _columns(weights: Array, turns: Array) -> Array:
    """Waves (N, 2 c k) of weights (N, c, J) times cosines and sines (N, J, 2 k)."""
    return discrepancies.apply_carrier(weights, turns).reshape(len(weights), -1)


# -- tail of the chi-square ------------------------------------------------------------
def log_tail(energy: Array, rank: Array | float) -> Array:
    """Log of the chi-square's upper tail, by its asymptote where that underflows."""
    a = np.maximum(rank, 1e-9) / 2.0
    x = np.maximum(energy, 0.0) / 2.0
    tail = special.gammaincc(a, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        correction = np.log1p((a - 1.0) / x)
        asymptote = -x + (a - 1.0) * np.log(x) - special.gammaln(a) + correction
        value = np.where(tail > 1e-280, np.log(tail), asymptote)
    return np.where(np.asarray(rank) == 0, 0.0, value)
