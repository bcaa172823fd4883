"""Bands of steady waves: over time, along the path, along the joints' travels.

A band is a set of frequencies over a clock, on the carriers that they may act on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed import units
from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers

#: frequencies a resolution cell, and the most of them in a band
OVER, MOST = 1.5, 6000
#: shortest period in time where times are not regular, s
SHORTEST = 12.0
#: shortest period along the path, m, or as a share of the median step between readings
#: if that is less: runs of several sizes distinguish waves from their aliases
FINEST, BETWEEN = 0.02, 0.125
#: longest period along a joint's travel as a share of it, and shortest one, m
LONG, SHORT = 3.0, 1e-3
#: periods in the session up to which waves are slow: these few are scanned apart from
#: the many fast ones
SLOW = 100.0
#: half periods in the session up to which all of the machine's parameters may swing
#: together
SWINGS = 20
#: places between two frequencies at which a peak is refined
FINE = np.linspace(-0.8, 0.8, 9)
#: readings that a feed must have, and ticks that a clock must have, for its waves to
#: mean something
LEAST = 16


@dataclasses.dataclass(frozen=True, slots=True)
class Band:
    """Waves of some frequencies over a clock, on some carriers.

    unit           of the clock: s, readings, m of path, travel_m
    clock          (N, J) at each of the poses that a reading sees, or (N, J, c) for each
                   column of a carrier
    carriers       (N, c, J) each
    frequencies    (k,) per unit of the clock
    names          of the carriers, in words
    legs           (c,) legs whose travel the clock is, if it is one
    """

    unit: str
    clock: Array
    carriers: list[Array]
    frequencies: Array
    names: list[str]
    legs: tuple[str, ...] = ()

    def refined(self, carrier: Array, k: int) -> Band:
        """The band about its k-th frequency, on one carrier."""
        step = 0.0
        if len(self.frequencies) > 1:
            step = float(np.diff(self.frequencies[:2])[0])
        near = self.frequencies[k] + step * FINE
        return dataclasses.replace(self, carriers=[carrier], frequencies=near)


def bands_by_kind(problem: GapProblem) -> list[list[Band]]:
    """Bands of slow waves in time, of fast ones, along the path, and along travels."""
    every = carriers.all_carriers(problem)
    time_bands = [[band] for band in _over_time(problem, every)]
    return [*time_bands, _along_path(problem, every[-1]), _along_travels(problem)]


def swing_bands(problem: GapProblem) -> list[Band]:
    """Slow waves in time of all the machine's parameters together."""
    carrier = carriers.parameter_carriers(problem)
    if _timed(problem):
        unit, span = "s", float(np.ptp(_times(problem)))
    else:
        unit, span = "readings", float(sum(len(s) for s in problem.series))
    if not carrier.shape[1] or span <= 0.0:
        return []
    progress = carriers.at_poses(problem, [s.session_progress for s in problem.states])
    frequencies = np.arange(1, SWINGS + 1) / (2.0 * span)
    names = ["all parameters together"]
    return [Band(unit, span * progress, [carrier], frequencies, names)]


def run_bands(problem: GapProblem) -> list[Band]:
    """Waves on a channel along each run, their phases its own, where no time is known."""
    if _timed(problem):
        return []
    arc = _arc(problem)
    runs = np.zeros((len(problem), len(problem.members)))
    for k, members in enumerate(problem.members):
        runs[members, k] = 1.0
    runs = runs[:, runs.sum(axis=0) >= LEAST]
    span = float(arc[:, 0].max())
    if not runs.shape[1] or span <= 0.0:
        return []
    longest = max(len(members) for members in problem.members)
    frequencies = _frequencies(span, 1.0 / span, 0.5 * longest / span)
    count = len(np.unique(problem.channel))
    channels = carriers.all_carriers(problem)[:count]
    names = carriers.carrier_names(problem)[:count]
    bands = []
    for channel, name in zip(channels, names, strict=True):
        carrier = channel * runs[:, :, None]
        bands.append(Band("m", arc, [carrier], frequencies, [f"{name}, run by run"]))
    return bands


def travels(problem: GapProblem) -> tuple[list[int], Array, Array]:
    """Sliding joints with a travel long enough for waves, and all joints' travels.

    Numbers of these joints, places (N, J, nq) of all joints in m or rad, and their
    spans (nq,).
    """
    place = carriers.at_poses(problem, [s.joints for s in problem.states])
    place -= place.min(axis=(0, 1))
    spans = np.ptp(place[:, 0], axis=0)
    sliding = []
    for i, joint in enumerate(problem.measurement.machine.joints):
        if joint.unit == "m" and spans[i] > SHORT * LEAST:
            sliding.append(i)
    return sliding, place, spans


def travel_band(
    legs: Array,
    joints: Sequence[int],
    place: Array,
    frequencies: Array,
) -> Band:
    """Waves of one joint along its own travel, or of several joints at one period.

    Several joints have a phase each.

    legs     (N, nq, J) carriers of all joints
    place    (N, J, nq) places of all joints in their travel
    """
    names = tuple(f"leg {i + 1}" for i in joints)
    columns = list(joints)
    carrier = legs[:, columns]
    if len(names) == 1:
        clock = place[:, :, columns[0]]
        return Band("travel_m", clock, [carrier], frequencies, [names[0]], names)
    clock, name = place[:, :, columns], "all legs, each"
    return Band("travel_m", clock, [carrier], frequencies, [name], names)


def _timed(problem: GapProblem) -> bool:
    """Whether the time of every reading is known."""
    return "time" in problem.rows and bool(problem.rows["time"].notna().all())


def _times(problem: GapProblem) -> Array:
    """Time (N,) of each reading, s."""
    return np.asarray(problem.rows["time"].to_numpy(dtype=float))


def _over_time(problem: GapProblem, every: list[Array]) -> list[Band]:
    """Waves in time on a channel, on a joint, on the tool: slow ones, then fast ones."""
    if _timed(problem):
        unit, times = "s", _times(problem)
        clock = times - times.min()
        elapsed = [s.time - times.min() for s in problem.states]
        against = carriers.at_poses(problem, elapsed)
    else:
        unit, clock = "readings", _reading_numbers(problem)
        against = _since_run_start(problem, clock, every[0].shape[2])
    ticks = np.unique(clock)
    if len(ticks) < LEAST:
        return []
    step = float(np.median(np.diff(ticks)))
    # irregular times distinguish fast waves from slow, however far apart
    regular = unit == "readings" or _regular(ticks, step)
    highest = 0.5 / step if regular else 1.0 / SHORTEST
    clocks = np.column_stack([clock, against[:, 1:]])
    span = float(np.ptp(clock)) + step
    middle = min(SLOW / span, highest)
    names = carriers.carrier_names(problem)
    slow = _frequencies(span, 1.0 / span, middle)
    bands = [Band(unit, clocks, every, slow, names)]
    if highest > middle:
        fast = _frequencies(span, middle, highest)
        bands.append(Band(unit, clocks, every, fast, names))
    return bands


def _reading_numbers(problem: GapProblem) -> Array:
    """Number (N,) of each reading, from 0; its channels have the same one."""
    steps = problem.rows["reading"].diff().ne(0).to_numpy(dtype=float)
    number = np.cumsum(steps)
    return np.asarray(number - number.min())


def _regular(ticks: Array, step: float) -> bool:
    """Whether all ticks are whole steps apart."""
    places = (ticks - ticks[0]) / step
    return bool(np.abs(places - np.round(places)).max() <= 0.05)


def _along_path(problem: GapProblem, tool: Array) -> list[Band]:
    """Waves along the path of the tool, at one feed."""
    feed = np.zeros(len(problem))
    if "feed" in problem.rows:
        # a feed that is not known is the same in all readings
        feed = np.nan_to_num(problem.rows["feed"].to_numpy(dtype=float))
    arc, bands = _arc(problem), []
    for value in np.unique(np.round(feed, 9)):
        at_feed = np.isclose(feed, value)
        steps = np.diff(arc[at_feed, 0])
        steps = steps[steps > 1e-6]
        if at_feed.sum() < LEAST or not steps.size:
            continue
        span = float(arc[at_feed, 0].max())
        finest = min(FINEST, BETWEEN * float(np.median(steps)))
        highest = max(1.0 / finest, 1.0 / span)
        frequencies = _frequencies(span, 1.0 / span, highest)
        name = "the tool"
        if value > 0.0:
            speed = units.number(value * units.factor("min"), "mm")
            name = f"the tool at {speed:.0f} mm/min"
        carrier = np.where(at_feed[:, None, None], tool, 0.0)
        bands.append(Band("m", arc, [carrier], frequencies, [name]))
    return bands


def _along_travels(problem: GapProblem) -> list[Band]:
    """Waves of a joint along its own travel, and of all of them at one period."""
    legs = carriers.joint_carriers(problem)
    sliding, place, spans = travels(problem)
    bands = []
    for i in sliding:
        frequencies = _frequencies(spans[i], LONG / spans[i], 1.0 / SHORT)
        bands.append(travel_band(legs, [i], place, frequencies))
    if len(sliding) > 1:
        span = float(spans[sliding].max())
        frequencies = _frequencies(span, LONG / span, 1.0 / SHORT)
        bands.append(travel_band(legs, sliding, place, frequencies))
    return bands


def _frequencies(span: float, low: float, high: float) -> Array:
    """Frequencies so close that no wave over a span falls between them."""
    count = max(OVER * span * (high - low), 1.0)
    return np.linspace(low, high, int(min(count, MOST)))


def _since_run_start(problem: GapProblem, clock: Array, poses: int) -> Array:
    """The clock (N, poses) where no time is known.

    What a reading is read against was seen as its run began.
    """
    against = np.repeat(clock[:, None], poses, axis=1)
    for members in problem.members:
        against[members, 1:] = clock[members].min()
    return against


def _arc(problem: GapProblem) -> Array:
    """Way (N, J) of the tool since its run's first reading, m.

    Of what a reading is read against, it is the way back to that.
    """
    tool = carriers.at_poses(problem, [s.tool for s in problem.states])
    order = problem.rows["order"].to_numpy(dtype=float)
    arc = np.zeros(tool.shape[:2])
    for members in problem.members:
        at = members[np.argsort(order[members], kind="stable")]
        steps = np.linalg.norm(np.diff(tool[at, 0], axis=0), axis=1)
        arc[at[1:], 0] = np.cumsum(steps)
        offset = tool[members, 1:] - tool[at[0], 0]
        arc[members, 1:] = -np.linalg.norm(offset, axis=2)
    return arc
