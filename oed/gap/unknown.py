"""What an effect that nobody thought of may look like: smooth processes of low rank over the machine's state.

Each process is told as an effect, with columns of falling prior size, so that the same machinery serves: over time,
over the pose, over each joint's travel, over the place along a run and its direction, over the load. In the evidence
they are made orthogonal to what the parameters and the selected effects explain: an unknown remainder takes nothing
from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations_with_replacement, product

import numpy as np

from oed.batch import Array
from oed.effect import Column, Effect, State

#: prior standard deviation of a process, m in the reading or the joint: a micrometre
UNIT = 1e-6
#: feed (m/s) of usual size
FEED = 1.0 / 60.0
#: readings that a run must have for its harmonics to mean something
WAVES = 24
SOURCE = "Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464, for discrepancies as processes"


def _share(values: Array, low: float, high: float) -> Array:
    """Values as a share of a span, 0 where unknown."""
    with np.errstate(invalid="ignore"):
        share = (values - low) / max(high - low, 1e-12)
    return np.asarray(np.where(np.isfinite(share), share, 0.0))


def _cosines(share: Array, count: int) -> list[Array]:
    return [np.cos(np.pi * k * share) for k in range(1, count + 1)]


def _time(state: State) -> Array:
    return _share(state.time, *state.span) if np.isfinite(state.span[0]) else np.zeros(len(state))


def _read(state: State, name: str, size: float, wave: Array) -> Iterable[Column]:
    """The same form in each channel of the readings, with a coefficient of its own."""
    for channel in state.channels:
        yield Column(f"{name} {channel}", size, label=f"channel {channel}", reading={channel: wave})


def over_time(state: State) -> Iterable[Column]:
    """Drift of the readings."""
    if not np.isfinite(state.span[0]):
        return
    for k, wave in enumerate(_cosines(_time(state), 8), start=1):
        yield from _read(state, f"time {k}", UNIT / k, wave)


def joints_over_time(state: State) -> Iterable[Column]:
    """Drift of each joint."""
    if not np.isfinite(state.span[0]):
        return
    for i in state.limbs:
        for k, wave in enumerate(_cosines(_time(state), 5), start=1):
            yield Column(f"leg {i + 1} time {k}", UNIT / k, label=f"leg {i + 1}", joints={i: wave})


def windows(state: State) -> Iterable[Column]:
    """Something for a while: bumps of a twelfth of the session."""
    if not np.isfinite(state.span[0]):
        return
    share = _time(state)
    for k in range(12):
        yield from _read(state, f"window {k}", UNIT, np.exp(-0.5 * ((share - (k + 0.5) / 12.0) / 0.045) ** 2))


def over_pose(state: State) -> Iterable[Column]:
    """A smooth error over the workspace: products of the scaled pose up to the third degree."""
    yield from _products(state, _coordinates(state), "pose", 3 if len(state.machine.command) <= 3 else 2)


def _coordinates(state: State) -> Array:
    """Tool point and tilt of each pose, about the machine's middle, scaled by its workspace."""
    spans = np.array([0.15 if c.unit == "m" else 0.4 for c in state.machine.pose])
    return np.asarray((state.pose - state.home) / spans)


def _products(state: State, values: Array, name: str, degree: int) -> Iterable[Column]:
    for order in range(1, degree + 1):
        for combination in combinations_with_replacement(range(values.shape[1]), order):
            power = np.prod(values[:, combination], axis=1)
            yield from _read(state, f"{name} {combination}", UNIT / 2.0 ** (order - 1), power)


def at_a_place(state: State) -> Iterable[Column]:
    """Something at a place of the workspace: bumps about the middles of the tool's box, an eighth and a half wide."""
    span = np.maximum(np.ptp(state.tool, axis=0), 1e-9)
    for sides in product((0.0, 1.0), repeat=3):
        kept = [k for k in range(3) if span[k] > 0.02]
        if any(side for k, side in enumerate(sides) if k not in kept):
            continue
        corner = state.tool.min(axis=0) + np.array(sides) * span
        away = (((state.tool - corner) / span)[:, kept] ** 2).sum(axis=1)
        for width in (0.25, 0.5):
            name = "".join(str(int(s)) for s in sides)
            yield from _read(state, f"corner {name} {width}", UNIT, np.exp(-0.5 * away / width**2))


def in_a_run(state: State) -> Iterable[Column]:
    """Something in one run: its level and harmonics."""
    for run in dict.fromkeys(state.run):
        here = state.run == run
        if here.sum() < WAVES:
            continue
        waves = [np.ones(len(state))]
        for k in range(1, 5):
            waves += [np.cos(k * state.phase), np.sin(k * state.phase)]
        for k, wave in enumerate(waves):
            place = f"run {state.setup} {run}"
            for channel in state.channels:
                yield Column(f"{place} {k} {channel}", UNIT, label=place, reading={channel: np.where(here, wave, 0.0)})


def over_travel(state: State) -> Iterable[Column]:
    """An error of each joint over its travel."""
    for i, joint in enumerate(state.machine.joints):
        q = state.joints[:, i]
        low, high = (joint.lower, joint.upper) if np.isfinite(joint.lower) else (q.min(), q.max())
        for k, wave in enumerate(_cosines(_share(q, low, high) * 3.0, 6), start=1):
            yield Column(f"leg {i + 1} travel {k}", UNIT / (1.0 + k / 6.0), label=f"leg {i + 1}", joints={i: wave})


def over_phase(state: State) -> Iterable[Column]:
    """Harmonics along the runs, common to both directions and opposite in them."""
    sign = np.where(np.isfinite(state.direction), state.direction, 0.0)
    for k in range(1, 9):
        for name, wave in (("c", np.cos(k * state.phase)), ("s", np.sin(k * state.phase))):
            yield from _read(state, f"phase {name}{k}", UNIT / k, wave)
            yield from _read(state, f"phase {name}{k} direction", UNIT / k, wave * sign)
    yield from _read(state, "direction", UNIT, sign)


def over_sense(state: State) -> Iterable[Column]:
    """An error of each joint with the sign of its motion, over its travel."""
    for i in state.limbs:
        q = state.joints[:, i]
        share = _share(q, float(q.min()), float(q.max()))
        for k, wave in enumerate([np.ones(len(state)), *_cosines(share, 3)]):
            change = state.sense[:, i] * wave
            yield Column(f"leg {i + 1} sense {k}", UNIT / (1.0 + k / 2.0), label=f"leg {i + 1}", joints={i: change})


def over_load(state: State) -> Iterable[Column]:
    """An error that comes with the payload, over the pose and along the runs."""
    load = np.where(np.isfinite(state.payload), state.payload, 0.0)
    if state.heaviest == 0.0:
        return
    load = load / state.heaviest
    yield from _read(state, "load", UNIT, load)
    values = _coordinates(state) * load[:, None]
    yield from _products(state, values, "load", 1)
    for k in range(1, 5):
        yield from _read(state, f"load c{k}", UNIT / k, load * np.cos(k * state.phase))
        yield from _read(state, f"load s{k}", UNIT / k, load * np.sin(k * state.phase))


def over_feed(state: State) -> Iterable[Column]:
    """An error that comes with the feed, along the runs."""
    feed = np.where(np.isfinite(state.feed), state.feed, 0.0)
    if not feed.any():
        return
    sign = np.where(np.isfinite(state.direction), state.direction, 1.0)
    feed = (feed - FEED) / FEED
    yield from _read(state, "feed", UNIT, feed)
    for k in range(1, 5):
        for name, wave in (("c", np.cos(k * state.phase)), ("s", np.sin(k * state.phase))):
            yield from _read(state, f"feed {name}{k}", UNIT / k, feed * wave)
            yield from _read(state, f"feed {name}{k} direction", UNIT / k, feed * wave * sign)


def _process(name: str, about: str, columns: object) -> Effect:
    return Effect(name=name, source=SOURCE, about=about, columns=columns)  # type: ignore[arg-type]


PROCESSES: Sequence[Effect] = (
    _process("over time", "drift of the readings", over_time),
    _process("joints over time", "drift of the joints", joints_over_time),
    _process("for a while", "a disturbance for part of the session", windows),
    _process("over the pose", "a smooth error over the workspace", over_pose),
    _process("at a place", "an error at a place of the workspace", at_a_place),
    _process("in a run", "an error in one run", in_a_run),
    _process("over the travel", "an error of the joints over their travel", over_travel),
    _process("along the runs", "harmonics along the runs, with direction", over_phase),
    _process("with the motion", "an error with the sign of the joints' motion", over_sense),
    _process("with the load", "an error with the payload", over_load),
    _process("with the feed", "an error with the feed", over_feed),
)
