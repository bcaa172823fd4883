"""What a stage tells: readings chosen, taken as far as the instrument follows, identified, compensated.

Before a stage the machine's parameters have covariance S (in tolerance units). A reading y_i = h_i d + e_i of a machine
with error d ~ N(0, S) and a set-up with unknowns s ~ N(0, 1) is lost where |h_i d| is beyond the instrument's travel.
Those that are taken add information; the set-up's own unknowns are profiled out,

    L' = L + M_mm - M_ms (1 + M_ss)^-1 M_sm.

A machine that is far off loses nearly all readings, and will lose those of the next stage as well. So machines are
drawn, each keeps its own covariance (a kind), and S is their mean.

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
from oed.design.criterion.protocol import inverse
from oed.design.judge import Single
from oed.design.rules import Rules
from oed.design.search import climb, greedy
from oed.measurement import Measurement, Series
from oed.planning.option import Option

#: machines drawn to tell which readings are lost, and what linearisation cuts off
DRAWS = 48
#: machines drawn for a first look
ROUGH = 12
#: chance of being read beyond which no machines are drawn
CERTAIN = 0.999
#: machines drawn to tell how often a whole run can be read
MANY = 1000


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """One stage.

    option      the measurement;  chosen candidates of it
    seconds     time for mounting and reading
    available   (N,) probability that each chosen candidate can be read at all
    cut_off     (readings,) root mean square, SI, of what linearisation cuts off after the stage
    kinds       (P, n, n) covariances of the machine's parameters after it, in tolerance units, all equally likely: one
                where no reading is lost
    information (n, n) that it adds
    """

    option: Option
    chosen: Index
    seconds: float
    available: Array
    cut_off: Array
    kinds: Array
    information: Array

    @property
    def covariance(self) -> Array:
        """Covariance (n, n) of the machine's parameters after it, in tolerance units."""
        return mean(self.kinds)

    @property
    def series(self) -> tuple[Series, ...]:
        """The readings to take."""
        return self.option.taken(self.chosen)


def available(option: Option, covariance: Array) -> Array:
    """Probability (C,) that a machine with covariance (n, n), or kinds (P, n, n), can be read at each candidate.

    Readings of one run are lost together; how often, is told by drawn machines.
    """
    if option.travel is None:
        return np.ones(len(option.candidates))
    first, count = option.candidates.members.T
    if (count == 1).all():
        return np.asarray(_singly(option, covariance)[first])
    everyone = np.arange(len(option.candidates))
    each = max(MANY // len(_kinds(covariance)), 1)
    return np.asarray(_within(option, everyone, covariance, np.random.default_rng(0), each).mean(axis=0))


def available_at_most(option: Option, covariance: Array) -> Array:
    """A bound (C,) of the same from above: a run is no more likely to be read than the farthest of its readings."""
    if option.travel is None:
        return np.ones(len(option.candidates))
    single = _singly(option, covariance)
    return np.array([single[first : first + count].min() for first, count in option.candidates.members])


def _singly(option: Option, covariance: Array) -> Array:
    """Probability (readings,) that each reading by itself is within the travel, by machine and set-up."""
    assert option.travel is not None
    rows, n = _rows(option), option.machine_columns
    own = np.sum(rows[:, n:] ** 2, axis=1)
    by_machine = np.einsum("in,pnm,im->pi", rows[:, :n], _kinds(covariance), rows[:, :n], optimize=True)
    deviation = np.sqrt(np.maximum(own + by_machine, 1e-300))
    return np.asarray(erf(option.travel / deviation / np.sqrt(2.0)).mean(axis=0))


def _kinds(covariance: Array) -> Array:
    """(P, n, n) of a covariance (n, n), or of kinds."""
    return covariance[None] if covariance.ndim == 2 else covariance


def mean(covariance: Array) -> Array:
    """Covariance (n, n) over all kinds (P, n, n)."""
    return np.asarray(_kinds(covariance).mean(axis=0))


def _rows(option: Option) -> Array:
    """First channel of each reading (readings, free), SI over tolerances."""
    measurement = option.measurement
    rows = (measurement.jacobian(option.series, measurement.nominal) * measurement.tolerance)[:, measurement.free]
    return np.asarray(rows[_first_channels(measurement, option.series)])


def _first_channels(measurement: Measurement, series: tuple[Series, ...]) -> Index:
    rows, start = [], 0
    for s in series:
        channels = len(measurement.setups[s.setup].sigma)
        rows.append(start + channels * np.arange(len(s)))
        start += channels * len(s)
    return np.concatenate(rows)


def choose(
    option: Option,
    count: int,
    held: Array,
    criterion: Criterion,
    chances: Array,
    climbs: int = 1,
    seconds: float = np.inf,
) -> Index:
    """`count` candidates by greedy choice and exchange, each weighed with its chance of being read; as many as
    `seconds` pay for where their times differ.

    held (n, n) is the information about the machine's parameters before.
    """
    wide = option.candidates.blocks.shape[2]
    base = np.eye(wide)
    base[: len(held), : len(held)] = held
    worth = np.flatnonzero(chances > 1e-3)
    if len(worth) < count:
        worth = np.argsort(-chances, kind="stable")[:count]
    judge = Single(option.candidates.blocks[worth] * np.sqrt(chances[worth])[:, None, None], criterion, base)
    time = option.seconds[worth]
    if np.ptp(time) == 0.0:  # times that are all alike are paid for by the number
        rules, starts = Rules(size=count), []
    else:
        rules = Rules(size=count, budget=seconds, cost=time)
        starts = [_cheapest(time, count, seconds)]
    starts.append(greedy(judge, rules, 0.0, rung=0))
    for rung in range(judge.rungs) if climbs else ():
        starts = [climb(judge, rules, s, rung, climbs) for s in starts]
    found = max(starts, key=judge.value)
    return np.sort(worth[found] if len(found) else np.argsort(option.seconds, kind="stable")[:count])


def _cheapest(time: Array, count: int, seconds: float) -> Index:
    """The quickest candidates, `count` at the most, within `seconds`."""
    order = np.argsort(time, kind="stable")[:count]
    return np.asarray(order[np.cumsum(time[order]) <= seconds], dtype=np.intp)


def told(
    option: Option, chosen: Index, covariance: Array, rng: np.random.Generator, exact: bool = True, draws: int = DRAWS
) -> Stage:
    """The stage that reads the chosen candidates of a machine with covariance (n, n), or kinds (P, n, n).

    `exact` = False draws few machines, and takes no cut-off; else so many are drawn where readings may be lost.
    """
    chosen = np.sort(chosen)  # the order of their readings
    kinds = _kinds(covariance)
    held = np.asarray(np.linalg.inv(kinds), dtype=float)
    chances = available(option, covariance)[chosen]
    blocks, cut = option.candidates.blocks[chosen], np.zeros(0)
    shares = np.ones((1, len(chosen)))
    if option.travel is not None and chances.min() < CERTAIN:
        each = max((draws if exact else ROUGH) // len(kinds), 1)
        shares = _within(option, chosen, kinds, rng, each).astype(float)
        held = np.repeat(held, each, axis=0)
    left = _left(blocks, held, shares)
    if exact:
        cut = cut_off(option, chosen, left, rng, shares)
        left = _left(_blurred(option, chosen, blocks, cut), held, shares)
    seconds = option.mounting + float(option.seconds[chosen].sum())
    added = inverse(left.mean(axis=0)) - inverse(kinds.mean(axis=0))
    return Stage(option, chosen, seconds, chances, cut, left, added)


def _left(blocks: Array, held: Array, shares: Array) -> Array:
    """Covariances (P, n, n) after blocks are read, from information (P, n, n) before and shares (P or 1, N) read."""
    n = held.shape[1]
    patterns, which = np.unique(shares, axis=0, return_inverse=True)
    gained = np.array([information(blocks, p, n) for p in patterns])[which.ravel()]
    left = np.linalg.inv(held + gained)
    return np.asarray(0.5 * (left + np.swapaxes(left, 1, 2)))


def information(blocks: Array, shares: Array, columns: int) -> Array:
    """Information (n, n) about the machine, n = `columns`, of blocks (N, k, n + s) with shares (N,) of being read."""
    flat = (blocks * np.sqrt(shares)[:, None, None]).reshape(-1, blocks.shape[2])
    m = flat.T @ flat
    if blocks.shape[2] == columns:
        return np.asarray(m)
    own = m[columns:, columns:] + np.eye(blocks.shape[2] - columns)
    side = m[columns:, :columns]
    return np.asarray(m[:columns, :columns] - side.T @ np.linalg.solve(own, side))


def _within(option: Option, chosen: Index, covariance: Array, rng: np.random.Generator, each: int) -> Array:
    """Which chosen candidates drawn machines can read (P each, N), all their readings being within the travel: `each`
    machines of every kind, one kind after the other."""
    assert option.travel is not None
    n = option.machine_columns
    roots = _roots(np.repeat(_kinds(covariance), each, axis=0))
    errors = rng.standard_normal((len(roots), int(option.measurement.free.sum())))
    errors[:, :n] = np.einsum("pnm,pm->pn", roots, errors[:, :n])
    off = np.abs(errors @ _rows(option).T) <= option.travel
    first, count = option.candidates.members[chosen].T
    # the last column is only an end that `reduceat` may name
    padded = np.hstack([off, np.ones((len(off), 1), dtype=bool)])
    return np.asarray(np.logical_and.reduceat(padded, np.column_stack([first, first + count]).ravel(), axis=1)[:, ::2])


def _roots(covariances: Array) -> Array:
    """R (P, n, n) with R R^T = covariances, positive semidefinite up to rounding."""
    values, vectors = np.linalg.eigh(covariances)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


def cut_off(option: Option, chosen: Index, covariance: Array, rng: np.random.Generator, shares: Array) -> Array:
    """Root mean square (readings,), SI, of exact readings less their linearisation, for machines drawn from the
    covariance (n, n), or kinds (P, n, n), around the nominal one.

    shares (P or 1, N): machines that do not read a candidate do not count for it, nor those that cannot reach its pose;
    inf where none can.
    """
    measurement, n = option.measurement, option.machine_columns
    series = option.taken(chosen)
    free = np.flatnonzero(measurement.free)
    scale = measurement.tolerance[free]
    kinds = _kinds(covariance)
    each = max(DRAWS // 2 // len(kinds), 1)
    roots = _roots(np.repeat(kinds, each, axis=0))
    errors = np.zeros((len(roots), len(measurement.nominal)))
    errors[:, free[:n]] = np.einsum("pnm,pm->pn", roots, rng.standard_normal((len(roots), n))) * scale[:n]
    exact = measurement.try_readings(series, measurement.nominal + errors)
    linear = errors @ measurement.jacobian(series, measurement.nominal).T
    miss = exact - measurement.readings(series, measurement.nominal) - linear
    read = np.repeat(shares, _sizes(option, chosen), axis=1) > 0.0
    read = np.repeat(read, each, axis=0) if len(read) > 1 else read
    reached = np.isfinite(miss) & read
    mean = np.sum(np.where(reached, miss, 0.0) ** 2, axis=0) / np.maximum(reached.sum(axis=0), 1)
    hopeless = (~np.isfinite(miss)).all(axis=0)
    return np.asarray(np.where(hopeless, np.inf, np.sqrt(mean)))


def _sizes(option: Option, chosen: Index) -> Index:
    """Numbers, with all channels, that each chosen candidate (N,) reads."""
    candidates = option.candidates
    channels = np.array([len(option.measurement.setups[name].sigma) for name in candidates.setups])
    return np.asarray(candidates.members[chosen, 1] * channels[candidates.setup[chosen]])


def _blurred(option: Option, chosen: Index, blocks: Array, cut: Array) -> Array:
    """Blocks (N, k, n) with the readings' noise raised by the cut-off, by the mean over each candidate's readings."""
    sigma = option.measurement.sigma(option.taken(chosen))
    ratio = 1.0 + (cut / sigma) ** 2
    rows = _sizes(option, chosen)
    factor = np.add.reduceat(ratio, np.cumsum(rows) - rows) / rows
    return np.asarray(blocks / np.sqrt(factor)[:, None, None])
