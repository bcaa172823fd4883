"""What an effect that nobody thought of may look like: smooth processes of low rank
over the machine's state.

Each process is told as an effect, with columns of falling prior size, so that the same
machinery serves: over time, over the pose, over each joint's travel, over the place
along a run and its direction, over the load. In the evidence they are made orthogonal
to what the parameters and the selected effects explain: an unknown remainder takes
nothing from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import combinations_with_replacement

import numpy as np

from oed import smooth
from oed.arrays import Array
from oed.effect import Column, Effect, State
from oed.machine import Machine

#: prior standard deviation of a process, m in the reading or the joint: a micrometre
UNIT = 1e-6
#: feed (m/s) of usual size
FEED = 1.0 / 60.0
#: readings that a run must have for its harmonics to mean something
WAVES = 8
#: where bumps are: shares of the session, angles of a run; half a sector's width, rad
CENTRES, SECTORS, SECTOR = (
    [(k + 0.5) / 12.0 for k in range(12)],
    [np.pi * k / 6.0 for k in range(12)],
    0.35,
)
#: half-waves over the session of what drifts
DRIFTS = 12
#: shares of the session over which a tool's growth hangs together, and modes that it is
#: told by
REACHES, GROWING = (0.1, 0.2), 20
#: share of half a joint's travel over which an error along it hangs together, and modes
#: that it is told by
BENDS, CURVES = 0.5, 10
#: share of half the joints' travels over which an error of the workspace hangs
#: together; of its energy that its modes hold, and the most of them
PATCHES, WHOLE, MODES = (0.3, 0.8), 0.98, 24
#: what an error of the workspace may come with: the direction, the payload, the feed
WITH = range(3)
#: shares of the session within which what settles has done so
WITHIN = (0.05, 0.15, 0.5)
#: the same after a set-up's start; temperatures that may be recorded, by the order of
#: their names
MOUNTED, BODIES = (0.03, 0.1), range(8)
#: shares of a joint's travel within which a reversal is remembered
SINCE = (0.002, 0.01)
SOURCE = (
    "Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464, for discrepancies as"
    " processes"
)


def _share(values: Array, low: float, high: float) -> Array:
    """Values as a share of a span, 0 where unknown."""
    with np.errstate(invalid="ignore"):
        share = (values - low) / max(high - low, 1e-12)
    return np.asarray(np.where(np.isfinite(share), share, 0.0))


def _cosines(share: Array, count: int) -> list[Array]:
    return [np.cos(np.pi * k * share) for k in range(1, count + 1)]


def _read(state: State, name: str, size: float, wave: Array) -> Iterable[Column]:
    """The same form in each channel of the readings, with a coefficient of its own."""
    for channel in state.channels:
        yield Column(
            f"{name} {channel}",
            size,
            label=f"channel {channel}",
            reading={channel: wave},
        )


def _tool(state: State, name: str, size: float, wave: Array) -> Iterable[Column]:
    """The tool displaced along each axis of the base."""
    for k, axis in enumerate("xyz"):
        yield Column(f"{name} {axis}", size, joints=state.displaced(k, wave))


def _both(state: State, name: str, size: float, wave: Array) -> Iterable[Column]:
    """The same form in the readings and in the tool's place."""
    yield from _read(state, name, size, wave)
    yield from _tool(state, name, size, wave)


def over_time(state: State) -> Iterable[Column]:
    """Drift of the readings."""
    for k, wave in enumerate(_cosines(state.progress, DRIFTS), start=1):
        yield from _read(state, f"time {k}", UNIT / k, wave)


def tool_over_time(state: State) -> Iterable[Column]:
    """Drift of the tool's place."""
    for k, wave in enumerate(_cosines(state.progress, DRIFTS), start=1):
        yield from _tool(state, f"time {k}", UNIT / k, wave)


def joints_over_time(state: State) -> Iterable[Column]:
    """Drift of each joint."""
    for i in state.limbs:
        for k, wave in enumerate(_cosines(state.progress, DRIFTS), start=1):
            yield Column(
                f"leg {i + 1} time {k}",
                UNIT / k,
                label=f"leg {i + 1}",
                joints={i: wave},
            )


def tool_growing(state: State, reach: float) -> Iterable[Column]:
    """The tool longer and shorter along its axis, as a spindle that warms: a random
    smooth curve over the session.
    """
    for k in range(GROWING):
        grown = smooth.curve(
            2.0 * state.progress - 1.0, k, reach=2.0 * reach, count=GROWING, straight=1
        )
        change = state.lengthening * grown[:, None]
        yield Column(
            f"axis time {k}", UNIT, joints={i: change[:, i] for i in state.limbs}
        )


def settling(state: State, within: float) -> Iterable[Column]:
    """What fades after the session's start, as whatever warms up does, in the readings."""
    yield from _read(state, "settles", UNIT, np.exp(-state.progress / within))


def tool_settling(state: State, within: float) -> Iterable[Column]:
    """The same in the tool's place."""
    yield from _tool(state, "settles", UNIT, np.exp(-state.progress / within))


def joints_settling(state: State, within: float) -> Iterable[Column]:
    """The same of each joint."""
    for i in state.limbs:
        yield Column(
            f"leg {i + 1} settles",
            UNIT,
            label=f"leg {i + 1}",
            joints={i: np.exp(-state.progress / within)},
        )


def settling_mounted(state: State, within: float) -> Iterable[Column]:
    """What fades after each set-up's start, in the readings: warm from the hand, say."""
    yield from _read(state, "settles in each set-up", UNIT, _fading(state, within))


def tool_settling_mounted(state: State, within: float) -> Iterable[Column]:
    """The same in the tool's place."""
    yield from _tool(state, "settles in each set-up", UNIT, _fading(state, within))


def _fading(state: State, within: float) -> Array:
    """What fades from the start of a set-up (m,); nothing where there is only one,
    whose start is the session's.
    """
    if np.ptp(state.progress) > 1.0 - 1e-9:
        return np.zeros(len(state))
    return np.asarray(np.exp(-(state.progress - state.progress.min()) / within))


def over_temperature(state: State, body: float) -> Iterable[Column]:
    """An error of the readings with a recorded temperature."""
    yield from _read(state, "warm", UNIT, _risen(state, body))


def tool_over_temperature(state: State, body: float) -> Iterable[Column]:
    """The same of the tool's place."""
    yield from _tool(state, "warm", UNIT, _risen(state, body))


def joints_over_temperature(state: State, body: float) -> Iterable[Column]:
    """The same of each joint, over its travel."""
    rise = _risen(state, body)
    for i in state.limbs:
        q = state.joints[:, i]
        at = 2.0 * _share(q, float(q.min()), float(q.max())) - 1.0
        for name, change in (("warm", rise), ("warm travel", rise * at)):
            yield Column(
                f"leg {i + 1} {name}", UNIT, label=f"leg {i + 1}", joints={i: change}
            )


def _risen(state: State, body: float) -> Array:
    """How much warmer than at the session's start (m,), K, a body is: zeros where it
    was not recorded.
    """
    names = sorted(state.temperature)
    if body >= len(names):
        return np.zeros(len(state))
    name = names[int(body)]
    return np.asarray(np.nan_to_num(state.temperature[name] - state.start[name]))


def windows(state: State, when: float, lasts: float) -> Iterable[Column]:
    """Something for a while: a bump at a share of the session."""
    yield from _both(
        state, "while", UNIT, np.exp(-0.5 * ((state.progress - when) / lasts) ** 2)
    )


def run_start(state: State, readings: float) -> Iterable[Column]:
    """Something that fades after a run's first readings."""
    yield from _both(
        state, "start", UNIT, np.exp(-np.maximum(state.order, 0.0) / readings)
    )


def over_pose(state: State) -> Iterable[Column]:
    """A smooth error over the workspace: products of the scaled pose up to the third
    degree.
    """
    yield from _products(
        state, _coordinates(state), "pose", 3 if len(state.machine.command) <= 3 else 2
    )


def coming_back(state: State, reach: float) -> Iterable[Column]:
    """What is the same whenever the machine is there: a random smooth error over all
    joints' travels of the readings of each set-up.
    """
    yield from _field(state, reach, np.ones(len(state)))


def coming_back_with(state: State, reach: float, what: float) -> Iterable[Column]:
    """The same with the direction, the payload or the feed."""
    share = (state.direction, _loaded(state), (state.feed - FEED) / FEED)[int(what)]
    yield from _field(state, reach, np.where(np.isfinite(share), share, 0.0))


def _field(state: State, reach: float, share: Array) -> Iterable[Column]:
    if not share.any():
        return
    low, high = state.stroke
    at = np.column_stack(
        [2.0 * _share(state.joints[:, i], low[i], high[i]) - 1.0 for i in state.limbs]
    )
    for k, mode in enumerate(
        smooth.field(at, reach=reach, share=WHOLE, count=MODES).T, start=1
    ):
        yield from _read(state, f"{state.setup} {k}", UNIT, share * mode)


def _loaded(state: State) -> Array:
    """Payload (m,) as a share of the session's largest; zeros where unknown."""
    load = np.where(np.isfinite(state.payload), state.payload, 0.0)
    return load / state.heaviest if state.heaviest > 0.0 else np.zeros(len(state))


def _coordinates(state: State) -> Array:
    """Tool point and tilt of each pose, about the machine's middle, scaled by its
    workspace.
    """
    spans = np.array([0.15 if c.unit == "m" else 0.4 for c in state.machine.pose])
    return np.asarray((state.pose - state.home) / spans)


def _products(state: State, values: Array, name: str, degree: int) -> Iterable[Column]:
    for order in range(1, degree + 1):
        for combination in combinations_with_replacement(range(values.shape[1]), order):
            power = np.prod(values[:, combination], axis=1)
            yield from _read(
                state, f"{name} {combination}", UNIT / 2.0 ** (order - 1), power
            )


def in_a_sector(state: State, centre: float, way: float) -> Iterable[Column]:
    """Something in a sector of the runs, in one direction of travel."""
    off = np.angle(np.exp(1j * (state.phase - centre)))
    wave = np.exp(-0.5 * (off / SECTOR) ** 2) * (state.direction == way)
    yield from _both(state, "sector", UNIT, wave)


def in_a_run(state: State) -> Iterable[Column]:
    """Something in one run: its level and harmonics."""
    for run in dict.fromkeys(state.run):
        here = state.run == run
        if here.sum() < WAVES:
            continue
        waves = [np.ones(len(state))]
        for k in (1, 2):
            waves += [np.cos(k * state.phase), np.sin(k * state.phase)]
        for k, wave in enumerate(waves):
            place = f"run {state.setup} {run}"
            for channel in state.channels:
                yield Column(
                    f"{place} {k} {channel}",
                    UNIT,
                    label=place,
                    reading={channel: np.where(here, wave, 0.0)},
                )


def over_travel(state: State) -> Iterable[Column]:
    """An error of each joint over its travel: a random smooth curve over what the
    session reads of it.
    """
    low, high = state.stroke
    for i in state.limbs:
        at = 2.0 * _share(state.joints[:, i], low[i], high[i]) - 1.0
        for k in range(CURVES):
            curve = smooth.curve(at, k, reach=BENDS, count=CURVES, straight=1)
            yield Column(
                f"leg {i + 1} travel {k + 1}",
                UNIT,
                label=f"leg {i + 1}",
                joints={i: curve},
            )


def over_phase(state: State) -> Iterable[Column]:
    """Harmonics along the runs, common to both directions and opposite in them."""
    sign = np.where(np.isfinite(state.direction), state.direction, 0.0)
    for k in range(1, 9):
        for name, wave in (
            ("c", np.cos(k * state.phase)),
            ("s", np.sin(k * state.phase)),
        ):
            yield from _read(state, f"phase {name}{k}", UNIT / k, wave)
            yield from _read(state, f"phase {name}{k} direction", UNIT / k, wave * sign)
    yield from _read(state, "direction", UNIT, sign)


def tool_over_phase(state: State) -> Iterable[Column]:
    """The tool displaced by harmonics along the runs, common to both directions and
    opposite in them.
    """
    sign = np.where(np.isfinite(state.direction), state.direction, 0.0)
    yield from _tool(state, "direction", UNIT, sign)
    for k in range(1, 4):
        for name, wave in (
            ("c", np.cos(k * state.phase)),
            ("s", np.sin(k * state.phase)),
        ):
            yield from _tool(state, f"phase {name}{k}", UNIT / k, wave)
            yield from _tool(state, f"phase {name}{k} direction", UNIT / k, wave * sign)


def of_another(state: State, shift: float) -> Iterable[Column]:
    """An error of each joint with the motion of another, over its own travel."""
    count = len(state.limbs)
    if shift >= count:
        return
    rate = np.where(np.isfinite(state.rate), state.rate, state.sense)
    rate = rate / np.maximum(np.abs(rate).max(axis=0), 1e-12)
    for i in state.limbs:
        other, q = rate[:, (i + int(shift)) % count], state.joints[:, i]
        at = 2.0 * _share(q, float(q.min()), float(q.max())) - 1.0
        for name, change in (
            ("rate", other),
            ("speed", np.abs(other)),
            ("rate travel", other * at),
        ):
            yield Column(
                f"leg {i + 1} {name}", UNIT, label=f"leg {i + 1}", joints={i: change}
            )


def over_sense(state: State) -> Iterable[Column]:
    """An error of each joint with the sign of its motion, over its travel, and since it
    last turned back.
    """
    for i in state.limbs:
        q = state.joints[:, i]
        share = _share(q, float(q.min()), float(q.max()))
        gone = state.reversal[:, i] / max(float(np.ptp(q)), 1e-12)
        for k, since in enumerate(SINCE, start=1):
            change = state.sense[:, i] * np.exp(-gone / since)
            yield Column(
                f"leg {i + 1} turned {k}",
                UNIT,
                label=f"leg {i + 1}",
                joints={i: change},
            )
        for k, wave in enumerate([np.ones(len(state)), *_cosines(share, 3)]):
            change = state.sense[:, i] * wave
            yield Column(
                f"leg {i + 1} sense {k}",
                UNIT / (1.0 + k / 2.0),
                label=f"leg {i + 1}",
                joints={i: change},
            )


def over_load(state: State) -> Iterable[Column]:
    """An error that comes with the payload, over the pose and along the runs."""
    if state.heaviest == 0.0:
        return
    load = _loaded(state)
    yield from _read(state, "load", UNIT, load)
    values = _coordinates(state) * load[:, None]
    yield from _products(state, values, "load", 1)
    for k in range(1, 5):
        yield from _read(state, f"load c{k}", UNIT / k, load * np.cos(k * state.phase))
        yield from _read(state, f"load s{k}", UNIT / k, load * np.sin(k * state.phase))


def parameters_over_load(state: State) -> Iterable[Column]:
    """All of the machine's parameters shifted by the payload, together by a micrometre."""
    if state.heaviest == 0.0:
        return
    load = _loaded(state)
    for k, share in together(state.machine).items():
        name = state.machine.parameters[k].name
        yield Column(f"{name} load", UNIT * share, parameters={name: load})


def together(machine: Machine) -> dict[int, float]:
    """The machine's uncertain parameters, by number, with their shares of a change of
    all of them by one unit: each by its tolerance against that of lengths.
    """
    free = {k: p for k, p in enumerate(machine.parameters) if p.tolerance > 0.0}
    usual = np.median([p.tolerance for p in free.values() if p.unit == "m"] or [1.0])
    return {k: float(p.tolerance / usual / np.sqrt(len(free))) for k, p in free.items()}


def over_feed(state: State) -> Iterable[Column]:
    """An error that comes with the feed, along the runs."""
    feed = np.where(np.isfinite(state.feed), state.feed, 0.0)
    if not feed.any():
        return
    sign = np.where(np.isfinite(state.direction), state.direction, 1.0)
    feed = (feed - FEED) / FEED
    yield from _read(state, "feed", UNIT, feed)
    for k in range(1, 5):
        for name, wave in (
            ("c", np.cos(k * state.phase)),
            ("s", np.sin(k * state.phase)),
        ):
            yield from _read(state, f"feed {name}{k}", UNIT / k, feed * wave)
            yield from _read(
                state, f"feed {name}{k} direction", UNIT / k, feed * wave * sign
            )


def tool_over_feed(state: State) -> Iterable[Column]:
    """The tool displaced with the feed, along the runs."""
    feed = np.where(np.isfinite(state.feed), state.feed, 0.0)
    if not feed.any():
        return
    feed = (feed - FEED) / FEED
    yield from _tool(state, "feed", UNIT, feed)
    for k in range(1, 3):
        yield from _tool(state, f"feed c{k}", UNIT / k, feed * np.cos(k * state.phase))
        yield from _tool(state, f"feed s{k}", UNIT / k, feed * np.sin(k * state.phase))


def _process(
    name: str,
    about: str,
    columns: Callable[..., Iterable[Column]],
    **constants: Sequence[float],
) -> Effect:
    return Effect(
        name=name,
        source=SOURCE,
        about=about,
        columns=columns,
        constants={n: tuple(v) for n, v in constants.items()},
        needs=("direction: both",) if "way" in constants else (),
    )


#: processes that act on all readings alike, few enough that each reading is still told
#: by the others
BROAD = (
    "over time",
    "joints over time",
    "over the pose",
    "over the travel",
    "coming back",
    "along the runs",
    "with the motion",
    "with the load",
    "with the feed",
)
PROCESSES: Sequence[Effect] = (
    _process("over time", "drift of the readings", over_time),
    _process("tool over time", "drift of the tool's place", tool_over_time),
    _process("joints over time", "drift of the joints", joints_over_time),
    _process(
        "tool growing",
        "the tool longer and shorter along its axis",
        tool_growing,
        reach=REACHES,
    ),
    _process(
        "settling",
        "readings that settle as the session goes on",
        settling,
        within=WITHIN,
    ),
    _process(
        "tool settling",
        "the tool's place settles as the session goes on",
        tool_settling,
        within=WITHIN,
    ),
    _process(
        "joints settling",
        "joints that settle as the session goes on",
        joints_settling,
        within=WITHIN,
    ),
    _process(
        "settling in set-ups",
        "readings that settle in each set-up",
        settling_mounted,
        within=MOUNTED,
    ),
    _process(
        "tool settling in set-ups",
        "the tool's place settles in each set-up",
        tool_settling_mounted,
        within=MOUNTED,
    ),
    _process(
        "with a temperature",
        "an error of the readings with a temperature",
        over_temperature,
        body=BODIES,
    ),
    _process(
        "tool with a temperature",
        "the tool displaced with a temperature",
        tool_over_temperature,
        body=BODIES,
    ),
    _process(
        "joints with a temperature",
        "joints that change with a temperature",
        joints_over_temperature,
        body=BODIES,
    ),
    _process(
        "for a while",
        "a disturbance for part of the session",
        windows,
        when=CENTRES,
        lasts=(0.04, 0.1),
    ),
    _process(
        "at the start of runs",
        "an error that fades after a run's start",
        run_start,
        readings=(1.5, 5.0),
    ),
    _process("over the pose", "a smooth error over the workspace", over_pose),
    _process(
        "coming back",
        "an error that comes back in the same place",
        coming_back,
        reach=PATCHES,
    ),
    _process(
        "coming back with",
        "an error that comes back with what changes",
        coming_back_with,
        reach=PATCHES,
        what=WITH,
    ),
    _process("in a run", "an error in one run", in_a_run),
    _process(
        "over the travel", "an error of the joints over their travel", over_travel
    ),
    _process("along the runs", "harmonics along the runs, with direction", over_phase),
    _process(
        "tool along the runs",
        "the tool displaced along the runs, with direction",
        tool_over_phase,
    ),
    _process(
        "in a sector",
        "an error in a sector, one way",
        in_a_sector,
        centre=SECTORS,
        way=(-1.0, 1.0),
    ),
    _process(
        "with the motion", "an error with the sign of the joints' motion", over_sense
    ),
    _process(
        "with another's motion",
        "an error of a joint with another's motion",
        of_another,
        shift=range(1, 6),
    ),
    _process("with the load", "an error with the payload", over_load),
    _process(
        "parameters with the load",
        "parameters that change with the payload",
        parameters_over_load,
    ),
    _process("with the feed", "an error with the feed", over_feed),
    _process("tool with the feed", "the tool displaced with the feed", tool_over_feed),
)
