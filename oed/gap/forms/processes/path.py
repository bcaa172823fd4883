"""Processes along the runs: harmonics, sectors, errors of one run."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.effect import Column, State
from oed.gap.forms.processes.base import (
    UNIT,
    harmonics,
    known,
    on_readings,
    on_readings_and_tool,
    on_tool,
)

#: readings that a run must have for its harmonics to mean something
WAVES = 8
#: angles of a run at which a sector lies, and half its width, rad
SECTORS, SECTOR = [np.pi * k / 6.0 for k in range(12)], 0.35
#: harmonics of the readings and of the tool along the runs
HARMONICS, TOOL_HARMONICS = 8, 3


def over_phase(state: State) -> Iterable[Column]:
    """Harmonics along the runs, common to both directions and opposite in them."""
    sign = known(state.direction)
    for kind, k, wave in harmonics(state, HARMONICS):
        name = f"phase {kind}{k}"
        yield from on_readings(state, name, UNIT / k, wave)
        yield from on_readings(state, f"{name} direction", UNIT / k, wave * sign)
    yield from on_readings(state, "direction", UNIT, sign)


def tool_over_phase(state: State) -> Iterable[Column]:
    """The tool displaced by harmonics along the runs.

    They are common to both directions, and opposite in them.
    """
    sign = known(state.direction)
    yield from on_tool(state, "direction", UNIT, sign)
    for kind, k, wave in harmonics(state, TOOL_HARMONICS):
        name = f"phase {kind}{k}"
        yield from on_tool(state, name, UNIT / k, wave)
        yield from on_tool(state, f"{name} direction", UNIT / k, wave * sign)


def in_a_sector(state: State, centre: float, way: float) -> Iterable[Column]:
    """An error in a sector of the runs, in one direction of travel."""
    offset = np.angle(np.exp(1j * (state.phase - centre)))
    bump = np.exp(-0.5 * (offset / SECTOR) ** 2)
    wave = bump * (state.direction == way)
    yield from on_readings_and_tool(state, "sector", UNIT, wave)


def in_a_run(state: State) -> Iterable[Column]:
    """An error in one run: its level and harmonics."""
    for run in dict.fromkeys(state.run):
        inside = state.run == run
        if inside.sum() < WAVES:
            continue
        place = f"run {state.setup} {run}"
        level = np.ones(len(state))
        waves = [level, *(wave for _, _, wave in harmonics(state, 2))]
        for k, wave in enumerate(waves):
            change = np.where(inside, wave, 0.0)
            for channel in state.channels:
                name = f"{place} {k} {channel}"
                yield Column(name, UNIT, label=place, reading={channel: change})
