"""Building blocks of the processes: columns on readings, tool and joints, and scales."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations_with_replacement

import numpy as np

from oed.arrays import Array
from oed.effect import Column, State
from oed.machine import Machine

#: prior standard deviation of a process, m in the reading or the joint: a micrometre
UNIT = 1e-6
#: usual half spans of a workspace, by the unit of the coordinate
POSE_SPANS = {"m": 0.15, "rad": 0.4}
#: feed (m/s) of usual size
FEED = 1.0 / 60.0


def in_own_travel(q: Array) -> Array:
    """A joint's values (m,) as a place from -1 to 1 in the span that they have."""
    return in_travel(q, float(q.min()), float(q.max()))


def share_of_span(values: Array, low: float, high: float) -> Array:
    """Values as a share of a span, 0 where unknown."""
    with np.errstate(invalid="ignore"):
        share = (values - low) / max(high - low, 1e-12)
    return np.asarray(np.where(np.isfinite(share), share, 0.0))


def in_travel(values: Array, low: float, high: float) -> Array:
    """Values as a place in a span from -1 to 1."""
    return 2.0 * share_of_span(values, low, high) - 1.0


def cosines(share: Array, count: int) -> list[Array]:
    """Half-waves (m,) over a share of a span, from one on."""
    return [np.cos(np.pi * k * share) for k in range(1, count + 1)]


def harmonics(state: State, count: int) -> Iterable[tuple[str, int, Array]]:
    """Cosines and sines of multiples of the phase: kind, multiple, values (m,)."""
    for k in range(1, count + 1):
        yield "c", k, np.cos(k * state.phase)
        yield "s", k, np.sin(k * state.phase)


def on_joint(limb: int, name: str, size: float, change: Array) -> Column:
    """A change (m,) of one joint."""
    leg = f"leg {limb + 1}"
    return Column(f"{leg} {name}", size, label=leg, joints={limb: change})


def on_readings(
    state: State,
    name: str,
    size: float,
    change: Array,
) -> Iterable[Column]:
    """The same change (m,) in each channel of the readings, with its own coefficient."""
    for channel in state.channels:
        yield Column(
            f"{name} {channel}",
            size,
            label=f"channel {channel}",
            reading={channel: change},
        )


def on_tool(
    state: State,
    name: str,
    size: float,
    change: Array,
) -> Iterable[Column]:
    """The tool displaced along each axis of the base by a change (m,)."""
    for k, axis in enumerate("xyz"):
        yield Column(f"{name} {axis}", size, joints=state.displacing_joints(k, change))


def on_readings_and_tool(
    state: State,
    name: str,
    size: float,
    change: Array,
) -> Iterable[Column]:
    """The same change (m,) in the readings and in the tool's place."""
    yield from on_readings(state, name, size, change)
    yield from on_tool(state, name, size, change)


def powers_on_readings(
    state: State,
    values: Array,
    name: str,
    degree: int,
) -> Iterable[Column]:
    """Products of the columns of values (m, k), up to a degree, in the readings."""
    width = values.shape[1]
    for order in range(1, degree + 1):
        size = UNIT / 2.0 ** (order - 1)
        for combination in combinations_with_replacement(range(width), order):
            power = np.prod(values[:, combination], axis=1)
            yield from on_readings(state, f"{name} {combination}", size, power)


def known(values: Array) -> Array:
    """Values (m,), 0 where unknown."""
    return np.where(np.isfinite(values), values, 0.0)


def relative_payload(state: State) -> Array:
    """Payload (m,) as a share of the session's largest; zeros where unknown."""
    if state.max_payload <= 0.0:
        return np.zeros(len(state))
    return known(state.payload) / state.max_payload


def relative_feed(feed: Array) -> Array:
    """Feed (m,) as a share of the usual one, off it."""
    return (feed - FEED) / FEED


def scaled_pose(state: State) -> Array:
    """Pose about the machine's home, scaled by a usual workspace."""
    spans = [POSE_SPANS.get(c.unit, 0.4) for c in state.machine.pose]
    return np.asarray((state.pose - state.home) / np.array(spans))


def parameter_shares(machine: Machine) -> dict[int, float]:
    """The machine's uncertain parameters, by number, with shares of a common change.

    Each share is the parameter's tolerance against that of lengths; all together they
    make one unit.
    """
    free = {k: p for k, p in enumerate(machine.parameters) if p.tolerance > 0.0}
    lengths = [p.tolerance for p in free.values() if p.unit == "m"]
    usual = np.median(lengths or [1.0])
    root = np.sqrt(len(free))
    return {k: float(p.tolerance / usual / root) for k, p in free.items()}
