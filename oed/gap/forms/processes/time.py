"""Processes over time: drift, disturbances for a while, starts of runs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed import smooth_basis
from oed.effect import Column, State
from oed.gap.forms.processes.base import (
    UNIT,
    cosines,
    on_joint,
    on_readings,
    on_readings_and_tool,
    on_tool,
)

#: half-waves over the session of what drifts
DRIFTS = 12
#: shares of the session over which a tool's growth is correlated, and modes of it
REACHES, GROWING = (0.1, 0.2), 20
#: centres and durations of a disturbance, as shares of the session
CENTRES = [(k + 0.5) / 12.0 for k in range(12)]
DURATIONS = (0.04, 0.1)
#: readings within which what acts at a run's start fades
STARTS = (1.5, 5.0)


def over_time(state: State) -> Iterable[Column]:
    """Drift of the readings."""
    for k, wave in enumerate(cosines(state.session_progress, DRIFTS), start=1):
        yield from on_readings(state, f"time {k}", UNIT / k, wave)


def tool_over_time(state: State) -> Iterable[Column]:
    """Drift of the tool's place."""
    for k, wave in enumerate(cosines(state.session_progress, DRIFTS), start=1):
        yield from on_tool(state, f"time {k}", UNIT / k, wave)


def joints_over_time(state: State) -> Iterable[Column]:
    """Drift of each joint."""
    for i in state.limbs:
        for k, wave in enumerate(cosines(state.session_progress, DRIFTS), start=1):
            yield on_joint(i, f"time {k}", UNIT / k, wave)


def tool_growing(state: State, reach: float) -> Iterable[Column]:
    """The tool longer and shorter along its axis, as a spindle that warms.

    Its length is a random smooth curve over the session.
    """
    at = 2.0 * state.session_progress - 1.0
    for k in range(GROWING):
        length = smooth_basis.curve_mode(
            at, k, correlation_length=2.0 * reach, count=GROWING, detrend=1
        )
        change = state.joints_per_extension * length[:, None]
        joints = {i: change[:, i] for i in state.limbs}
        yield Column(f"axis time {k}", UNIT, joints=joints)


def windows(state: State, when: float, lasts: float) -> Iterable[Column]:
    """A disturbance for a while: a bump at a share of the session."""
    distance = (state.session_progress - when) / lasts
    bump = np.exp(-0.5 * distance**2)
    yield from on_readings_and_tool(state, "while", UNIT, bump)


def run_start(state: State, readings: float) -> Iterable[Column]:
    """What fades after a run's first readings."""
    fading = np.exp(-np.maximum(state.order, 0.0) / readings)
    yield from on_readings_and_tool(state, "start", UNIT, fading)
