"""Processes with the payload and with the feed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.effect import Column, State
from oed.gap.forms.processes.base import (
    UNIT,
    harmonics,
    known,
    on_readings,
    on_tool,
    parameter_shares,
    powers_on_readings,
    relative_feed,
    relative_payload,
    scaled_pose,
)

#: harmonics of the readings and of the tool along the runs
HARMONICS, TOOL_HARMONICS = 4, 2


def over_load(state: State) -> Iterable[Column]:
    """An error that comes with the payload, over the pose and along the runs."""
    if state.max_payload == 0.0:
        return
    load = relative_payload(state)
    yield from on_readings(state, "load", UNIT, load)
    values = scaled_pose(state) * load[:, None]
    yield from powers_on_readings(state, values, "load", 1)
    for kind, k, wave in harmonics(state, HARMONICS):
        yield from on_readings(state, f"load {kind}{k}", UNIT / k, load * wave)


def parameters_over_load(state: State) -> Iterable[Column]:
    """All of the machine's parameters shifted by the payload, by a micrometre in all."""
    if state.max_payload == 0.0:
        return
    load = relative_payload(state)
    for k, share in parameter_shares(state.machine).items():
        name = state.machine.parameters[k].name
        yield Column(f"{name} load", UNIT * share, parameters={name: load})


def over_feed(state: State) -> Iterable[Column]:
    """An error that comes with the feed, along the runs."""
    feed = known(state.feed)
    if not feed.any():
        return
    direction = state.direction
    sign = np.where(np.isfinite(direction), direction, 1.0)
    feed = relative_feed(feed)
    yield from on_readings(state, "feed", UNIT, feed)
    for kind, k, wave in harmonics(state, HARMONICS):
        name, both = f"feed {kind}{k}", feed * wave
        yield from on_readings(state, name, UNIT / k, both)
        yield from on_readings(state, f"{name} direction", UNIT / k, both * sign)


def tool_over_feed(state: State) -> Iterable[Column]:
    """The tool displaced with the feed, along the runs."""
    feed = known(state.feed)
    if not feed.any():
        return
    feed = relative_feed(feed)
    yield from on_tool(state, "feed", UNIT, feed)
    for kind, k, wave in harmonics(state, TOOL_HARMONICS):
        yield from on_tool(state, f"feed {kind}{k}", UNIT / k, feed * wave)
