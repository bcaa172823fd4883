"""Processes with a recorded temperature: errors of the readings, the tool, the joints."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.arrays import Array
from oed.effect import Column, State
from oed.gap.forms.processes.base import (
    UNIT,
    in_own_travel,
    on_joint,
    on_readings,
    on_tool,
)

#: temperatures that may be recorded, by the order of their names
BODIES = range(8)


def over_temperature(state: State, body: float) -> Iterable[Column]:
    """An error of the readings with a recorded temperature."""
    yield from on_readings(state, "warm", UNIT, _rise(state, body))


def tool_over_temperature(state: State, body: float) -> Iterable[Column]:
    """The tool displaced with a recorded temperature."""
    yield from on_tool(state, "warm", UNIT, _rise(state, body))


def joints_over_temperature(state: State, body: float) -> Iterable[Column]:
    """An error of each joint with a recorded temperature, over its travel."""
    rise = _rise(state, body)
    for i in state.limbs:
        q = state.joints[:, i]
        at = in_own_travel(q)
        yield on_joint(i, "warm", UNIT, rise)
        yield on_joint(i, "warm travel", UNIT, rise * at)


def _rise(state: State, body: float) -> Array:
    """How much warmer than at the session's start a body is (m,), K.

    Zeros where it was not recorded.
    """
    names = sorted(state.temperature)
    if body >= len(names):
        return np.zeros(len(state))
    name = names[int(body)]
    rise = state.temperature[name] - state.start_temperature[name]
    return np.asarray(np.nan_to_num(rise))
