"""Readings that no instrument took: doubled, frozen, computed, or coarsely rounded."""

import dataclasses

import numpy as np
import pandas as pd
import scipy

from oed.base import Array, Index
from oed.checks.session import SessionReadings
from oed.measurement import Series

#: probability that a correct session has as many equal readings
COPY_FALSE_ALARM = 1e-5
#: share of the stated noise within which a reading is one of the nominal machine
NOMINAL_SHARE = 0.1
COARSE_STEPS = 3.0  #: rounding steps, in the stated noise, from which on they matter


@dataclasses.dataclass(frozen=True)
class EqualReadings:
    """Readings with equal values, by number."""

    readings: tuple[int, ...]
    same_pose: bool  #: whether they were taken at the same pose


def resolution(session: SessionReadings, members: Index) -> float:
    """Step of which all these values are multiples, SI; 0 for none of DIGITS digits."""
    channel = str(session.values["channel"].iloc[int(members[0])])
    factor = session.column(channel).factor
    values = session.y[members] / factor
    if np.ptp(values) <= 1e-9 * np.abs(values).max(initial=0.0):
        return 0.0
    for digits in range(-2, 9 + 1):
        step = 10.0**-digits
        rest = values / step - np.round(values / step)
        tolerance = 1e-9 * np.maximum(1.0, np.abs(values / step))
        if (np.abs(rest) <= np.minimum(tolerance, 1e-2)).all():
            return step * factor
    return 0.0


def equal_readings(session: SessionReadings) -> list[EqualReadings]:
    """Groups of readings with equal values that chance does not explain."""
    groups: list[EqualReadings] = []
    shown = session.shown
    for s, span in zip(session.series, session.spans, strict=True):
        table = session.y[span].reshape(len(s), -1)
        if not shown[span].any() or _taken_at_a_stop(s, table):
            continue
        first = int(session.reading_of_value[span.start])
        labels = pd.DataFrame(table).groupby(list(range(table.shape[1]))).indices
        equal = [np.sort(rows) for rows in labels.values() if len(rows) > 1]
        pairs = sum(len(rows) * (len(rows) - 1) // 2 for rows in equal)
        if not pairs or not _unlikely(session, s, span, table, pairs):
            continue
        for rows in equal:
            joints = s.q[s.index[rows, 0]]
            same = bool(np.ptp(joints, axis=0).max() < 1e-9)
            numbers = tuple(int(first + k) for k in rows)
            groups.append(EqualReadings(numbers, same))
    return groups


def interpolated_readings(session: SessionReadings) -> Index:
    """Readings, by number, that are the mean of their neighbours in a run to the last
    digit, more often than chance allows.
    """
    between: list[int] = []
    expected = 0.0
    frame = session.values[session.shown]
    places = np.flatnonzero(session.shown)
    for rows in frame.groupby(["setup", "run", "channel"], sort=False).indices.values():
        members = places[rows]
        step = resolution(session, members)
        if len(members) < 3 or step <= 0.0:
            continue
        y = session.y[members]
        bend = y[:-2] - 2.0 * y[1:-1] + y[2:]
        # half a step of rounding, twice
        is_mean = np.abs(bend) <= 1.001 * step
        between += session.reading_of_value[members[1:-1][is_mean]].tolist()
        noise = 2.0 * float(
            np.median(session.measurement.sigma(session.series)[members])
        )
        wide = np.sqrt(2.0 * np.pi) * max(_spread(bend), noise)
        expected += len(bend) * min(3.0 * step / wide, 1.0)
    at_least_as_many = scipy.special.pdtrc(len(between) - 1, expected)
    if not between or at_least_as_many >= COPY_FALSE_ALARM:
        return np.empty(0, dtype=np.intp)
    return np.unique(np.array(between, dtype=np.intp))


def _taken_at_a_stop(series: Series, table: Array) -> bool:
    """Whether joints were recorded where the reading had one value, as at a contact."""
    is_recorded = bool(np.isnan(series.command).all())
    return is_recorded and bool((np.ptp(table, axis=0) == 0.0).all())


def _unlikely(
    session: SessionReadings, series: Series, span: slice, table: Array, pairs: int
) -> bool:
    """Whether chance gives as many equal pairs as seldom as COPY_FALSE_ALARM.

    Two values of a density f agree in a rounding step d with probability d times the
    integral of f^2: over all runs, the poses of a run, or the noise of repeated ones.
    """
    n, channels = table.shape
    sigma = session.measurement.sigma(session.series)[span].reshape(n, channels)
    noise = np.median(sigma, axis=0)
    places = np.arange(span.start, span.stop).reshape(n, channels)
    step = np.array([resolution(session, column) for column in places.T])

    def agreement(values: Array) -> float:
        """Probability that two of some readings (k, channels) are equal."""
        spread = [_spread(column) for column in values.T]
        wide = 2.0 * np.sqrt(np.pi) * np.maximum(spread, noise)
        return float(np.minimum(step / wide, 1.0).prod())

    poses = pd.DataFrame(series.q[series.index[:, 0]].round(9))
    same = _pairs(poses.groupby(list(poses.columns)).size().to_numpy())
    runs = [table[series.run == run] for run in dict.fromkeys(series.run)]
    within = np.array([_pairs(np.array([len(run)])) for run in runs])
    expected = same * agreement(np.zeros((1, channels)))
    expected += float(within @ [agreement(run) for run in runs])
    expected += max(_pairs(np.array([n])) - within.sum(), 0.0) * agreement(table)
    at_least_as_many = scipy.special.pdtrc(pairs - 1, expected)
    return bool(at_least_as_many < COPY_FALSE_ALARM)


def _pairs(sizes: Index) -> float:
    return float(np.sum(sizes * (sizes - 1) / 2))


def _spread(values: Array) -> float:
    """Robust standard deviation: half the distance between 16 % and 84 %."""
    low, high = np.quantile(values, [0.16, 0.84])
    return float(0.5 * (high - low))


def computed_readings(session: SessionReadings, nominal: Array, sd: Array) -> Index:
    """Readings, by number, nearer the nominal ones, of `sd` (N,), than by chance."""
    sigma = session.measurement.sigma(session.series)
    close = NOMINAL_SHARE * sigma + np.minimum(_rounding(session), sigma)
    shown = session.shown
    near = shown & (np.abs(session.y - nominal) <= close)
    density = 2.0 * close / (np.sqrt(2.0 * np.pi) * sd)
    expected = float(np.minimum(density, 1.0)[shown].sum())
    count = int(near.sum())
    if not count or count < 0.3 * shown.sum() or 3.0 * expected > count:
        return np.empty(0, dtype=np.intp)
    return np.unique(session.reading_of_value[near])


def _rounding(session: SessionReadings) -> Array:
    """Half the rounding step (N,) of each value, SI."""
    half = np.zeros(len(session))
    frame = session.values
    for rows in frame.groupby(["setup", "channel"], sort=False).indices.values():
        half[rows] = 0.5 * resolution(session, rows)
    return half


@dataclasses.dataclass(frozen=True)
class CoarseReadings:
    """Readings of a channel that are multiples of a step, SI, above their noise."""

    channel: str
    step: float
    readings: tuple[int, ...]  #: their numbers
    run: str = ""  #: in which they are; empty for all of the file


def coarse_columns(session: SessionReadings) -> list[CoarseReadings]:
    """Channels, or runs, rounded far above the stated noise and not as stated."""
    coarse = []
    for channel, rows in session.values.groupby("channel", sort=False).indices.items():
        whole = _coarse(session, str(channel), rows)
        coarse += [whole] if whole else _coarse_runs(session, str(channel), rows)
    return coarse


def _coarse_runs(
    session: SessionReadings, channel: str, rows: Index
) -> list[CoarseReadings]:
    """Runs whose values chance does not make as round as they are."""
    usual = resolution(session, rows)
    runs = session.values.iloc[rows].groupby(["setup", "run"], sort=False).indices
    coarse = []
    for (_, run), places in runs.items():
        members = rows[places]
        one = _coarse(session, channel, members)
        if one is None or usual <= 0.0:
            continue
        if len(runs) * (usual / one.step) ** len(members) < COPY_FALSE_ALARM:
            coarse.append(dataclasses.replace(one, run=str(run)))
    return coarse


def _coarse(
    session: SessionReadings, channel: str, rows: Index
) -> CoarseReadings | None:
    """Values of a channel, where their step exceeds what is stated; None otherwise."""
    step = resolution(session, rows)
    sigma = session.measurement.sigma(session.series)[rows]
    setups = session.measurement.setups
    stated = [
        c.resolution
        for s in session.series
        for c in setups[s.setup].instrument.channels
        if c.name == channel
    ]
    is_stated = step <= 1.000001 * max(stated, default=0.0)
    if is_stated or step <= COARSE_STEPS * float(np.median(sigma)):
        return None
    numbers = np.unique(session.reading_of_value[rows]).tolist()
    return CoarseReadings(channel, step, tuple(numbers))
