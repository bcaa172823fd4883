"""What a stage tells: readings chosen, taken as far as the instrument follows, identified, compensated.

Before a stage the machine's parameters have covariance S (in tolerance units). A reading y_i = h_i d + e_i of a machine
with error d ~ N(0, S) and a set-up with unknowns s ~ N(0, 1) is lost where |h_i d| is beyond the instrument's travel.
Those that are taken add information; the set-up's own unknowns are profiled out,

    L' = L + M_mm - M_ms (1 + M_ss)^-1 M_sm.

What linearisation cuts off is estimated from the exact model: with errors d' ~ N(0, S') left after the stage,
r_i = y_i(d') - y_i(0) - h_i d' has a root mean square c_i, which the stage's readings carry beside their noise.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.special import erf

from oed.batch import Array
from oed.design.blocks import Index
from oed.design.criterion import Criterion
from oed.design.judge import Single
from oed.design.rules import Rules
from oed.design.search import climb, greedy
from oed.measurement import Measurement, Series
from oed.planning.option import Option

#: machines drawn to tell which readings are lost, and what linearisation cuts off
DRAWS = 48
#: machines drawn for a first look
ROUGH = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """One stage.

    option      the measurement;  chosen candidates of it
    seconds     time for mounting and reading
    available   (N,) probability that each chosen candidate can be read at all
    cut_off     (readings,) root mean square, SI, of what linearisation cuts off after the stage
    covariance  (n, n) of the machine's parameters after it, in tolerance units
    information (n, n) that it adds
    """

    option: Option
    chosen: Index
    seconds: float
    available: Array
    cut_off: Array
    covariance: Array
    information: Array

    @property
    def series(self) -> tuple[Series, ...]:
        """The readings to take."""
        return self.option.taken(self.chosen)


def available(option: Option, covariance: Array) -> Array:
    """Probability (C,) that a machine with covariance (n, n) stays within the travel at each candidate."""
    if option.travel is None:
        return np.ones(len(option.candidates))
    deviation = _deviations(option, covariance)
    told = erf(option.travel / np.maximum(deviation, 1e-300) / np.sqrt(2.0))
    return np.array([told[first : first + count].prod() for first, count in option.candidates.members])


def _deviations(option: Option, covariance: Array) -> Array:
    """Standard deviation, SI, of the first channel of each reading (readings,), by machine and set-up."""
    measurement, n = option.measurement, option.machine_columns
    own = np.eye(int(measurement.free.sum()))
    own[:n, :n] = covariance
    rows = (measurement.jacobian(option.series, measurement.nominal) * measurement.tolerance)[:, measurement.free]
    first = _first_channels(measurement, option.series)
    return np.asarray(np.sqrt(np.einsum("in,nm,im->i", rows[first], own, rows[first], optimize=True)))


def _first_channels(measurement: Measurement, series: tuple[Series, ...]) -> Index:
    rows, start = [], 0
    for s in series:
        channels = len(measurement.setups[s.setup].sigma)
        rows.append(start + channels * np.arange(len(s)))
        start += channels * len(s)
    return np.concatenate(rows)


def choose(
    option: Option, count: int, held: Array, covariance: Array, criterion: Criterion, chances: Array, climbs: int = 1
) -> Index:
    """`count` candidates by greedy choice and exchange, each weighed with its chance of being read.

    held (n, n) is the information about the machine's parameters before.
    """
    wide = option.candidates.blocks.shape[2]
    base = np.eye(wide)
    base[: len(held), : len(held)] = held
    worth = np.flatnonzero(chances > 1e-3)
    if len(worth) < count:
        worth = np.argsort(-chances, kind="stable")[:count]
    judge = Single(option.candidates.blocks[worth] * np.sqrt(chances[worth])[:, None, None], criterion, base)
    rules = Rules(size=count)
    found = greedy(judge, rules, 0.0, rung=0)
    for rung in range(judge.rungs) if climbs else ():
        found = climb(judge, rules, found, rung, climbs)
    return np.sort(worth[found])


def told(option: Option, chosen: Index, covariance: Array, rng: np.random.Generator, exact: bool = True) -> Stage:
    """The stage that reads the chosen candidates of a machine with covariance (n, n).

    Readings are lost together (a machine far off loses nearly all), so the covariance left is the mean over drawn
    machines of what their own readings leave. `exact` = False takes few of them, and no cut-off.
    """
    held = inverse(covariance)
    chances = available(option, covariance)[chosen]
    blocks, cut = option.candidates.blocks[chosen], np.zeros(0)
    within = None
    if option.travel is not None and chances.min() < 0.999:
        within = _within(option, chosen, covariance, rng, DRAWS if exact else ROUGH)
    left = _left(blocks, held, chances, within)
    if exact:
        cut = cut_off(option, chosen, left, rng)
        left = _left(_blurred(option, chosen, blocks, cut), held, chances, within)
    seconds = option.mounting + float(option.seconds[chosen].sum())
    return Stage(option, chosen, seconds, chances, cut, left, inverse(left) - held)


def _left(blocks: Array, held: Array, chances: Array, within: Array | None) -> Array:
    """Covariance after blocks are read: with expected information, or the mean over machines (D, N) of which each
    reads what is within its travel."""
    if within is None:
        return inverse(held + information(blocks, chances, len(held)))
    kinds, counts = np.unique(within, axis=0, return_counts=True)
    each = [inverse(held + information(blocks, k.astype(float), len(held))) for k in kinds]
    return np.asarray(np.tensordot(counts / len(within), np.array(each), axes=1))


def information(blocks: Array, shares: Array, columns: int) -> Array:
    """Information (n, n) about the machine, n = `columns`, of blocks (N, k, n + s) with shares (N,) of being read."""
    flat = (blocks * np.sqrt(shares)[:, None, None]).reshape(-1, blocks.shape[2])
    m = flat.T @ flat
    if blocks.shape[2] == columns:
        return np.asarray(m)
    own = m[columns:, columns:] + np.eye(blocks.shape[2] - columns)
    side = m[columns:, :columns]
    return np.asarray(m[:columns, :columns] - side.T @ np.linalg.solve(own, side))


def _within(option: Option, chosen: Index, covariance: Array, rng: np.random.Generator, draws: int) -> Array:
    """Which chosen candidates drawn machines can read (draws, N): all their readings are within the travel."""
    assert option.travel is not None
    measurement, n = option.measurement, option.machine_columns
    scale = measurement.tolerance[measurement.free]
    errors = rng.standard_normal((draws, len(scale)))
    errors[:, :n] = errors[:, :n] @ _root(covariance).T
    rows = measurement.jacobian(option.series, measurement.nominal)[:, measurement.free] * scale
    off = np.abs(errors @ rows[_first_channels(measurement, option.series)].T) <= option.travel
    return np.array([[d[a : a + c].all() for a, c in option.candidates.members[chosen]] for d in off])


def _root(covariance: Array) -> Array:
    """R with R R^T = covariance (n, n), positive semidefinite up to rounding."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def cut_off(option: Option, chosen: Index, covariance: Array, rng: np.random.Generator) -> Array:
    """Root mean square (readings,), SI, of exact readings less their linearisation, for machines drawn from the
    covariance (n, n) around the nominal one; NaN readings (out of reach) do not count."""
    measurement, n = option.measurement, option.machine_columns
    series = option.taken(chosen)
    free = np.flatnonzero(measurement.free)
    scale = measurement.tolerance[free]
    errors = np.zeros((DRAWS // 2, len(measurement.nominal)))
    errors[:, free[:n]] = (rng.standard_normal((DRAWS // 2, n)) @ _root(covariance).T) * scale[:n]
    exact = measurement.try_readings(series, measurement.nominal + errors)
    linear = errors @ measurement.jacobian(series, measurement.nominal).T
    miss = exact - measurement.readings(series, measurement.nominal) - linear
    return np.asarray(np.sqrt(np.nanmean(miss**2, axis=0)))


def _blurred(option: Option, chosen: Index, blocks: Array, cut: Array) -> Array:
    """Blocks (N, k, n) with the readings' noise raised by the cut-off, by the mean over each candidate's readings."""
    sigma = option.measurement.sigma(option.taken(chosen))
    ratio = 1.0 + (cut / sigma) ** 2
    per = np.array_split(ratio, len(chosen)) if len(ratio) % len(chosen) == 0 else [ratio] * len(chosen)
    factor = np.array([np.mean(p) for p in per])
    return np.asarray(blocks / np.sqrt(factor)[:, None, None])


def inverse(m: Array) -> Array:
    inverted = np.linalg.inv(m)
    return np.asarray(0.5 * (inverted + inverted.T))
