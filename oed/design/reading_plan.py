"""Readings as a whole plan: at other commands, back on hold, and what is wrong with
them, by `oed.measurement` alone.

Nothing here knows of the programme that found a plan (`oed.design.polish`): what it
says is checked anew.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.arrays import Array
from oed.design import reading_slopes
from oed.design.reading_slopes import TOOL
from oed.instrument import Setup
from oed.measurement import Measurement, Series

#: by how much a held reading (m, rad) and a joint may miss at the end
HELD, JOINT = 1e-9, 1e-9

Ranges = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class ReadingPlan:
    """Readings with the measurement they belong to."""

    measurement: Measurement
    series: tuple[Series, ...]

    def setup(self, s: Series) -> Setup:
        """Set-up of a series."""
        return self.measurement.setups[s.setup]

    def taught(self, s: Series) -> bool:
        """Whether the last pose of a series is its teach pose."""
        return self.setup(s).teach is not None


def shift(measurement: Measurement) -> Array:
    """(n_dof, 3): by how much a tool moves each command coordinate."""
    return np.array(
        [[float(c.name == n) for n in "xyz"] for c in measurement.machine.command]
    )


def values(setup: Setup) -> dict[str, float]:
    """Settings and tool of a set-up by name, SI."""
    return {**setup.settings, **dict(zip(TOOL, setup.tool, strict=True))}


def commanded(plan: ReadingPlan, commands: Sequence[Array]) -> ReadingPlan:
    """The readings at other commands (m, n_dof), teach poses as taught. Raises
    AssemblyError for some out of reach.
    """
    made = []
    for s, c in zip(plan.series, commands, strict=True):
        c = c.copy()
        if plan.taught(s):
            c[-1] = plan.setup(s).teach
        x, q = plan.measurement.kinematics.inverse(
            c, None, np.array(plan.setup(s).tool)
        )
        made.append(dataclasses.replace(s, q=q, start=x, command=c))
    return ReadingPlan(plan.measurement, tuple(made))


def home_clear(measurement: Measurement) -> float:
    """det phi_x at home, with its sign; not for redundant machines."""
    machine = measurement.machine
    x, q = measurement.kinematics.inverse(machine.home_command)
    return float(reading_slopes.pose(machine).clear(x[0], q[0]))


def _off(plan: ReadingPlan, s: Series, travel: float | None) -> Array | None:
    """By how much (n,) the readings of a series are off what they hold or off its
    travel; None where nothing is.
    """
    setup = plan.setup(s)
    if setup.instrument.holds is None:
        return None
    y = plan.measurement.readings([s], plan.measurement.nominal).reshape(len(s), -1)[
        :, 0
    ]
    off = y - setup.instrument.holds(setup.settings)
    return np.asarray(off - np.clip(off, -(travel or 0.0), travel or 0.0))


def missed(plan: ReadingPlan, travel: float | None) -> float:
    """By how much (m, rad), at the most, a reading is off what it holds or off its
    travel.
    """
    off = [o for s in plan.series if (o := _off(plan, s, travel)) is not None]
    return max((float(np.abs(o).max()) for o in off), default=0.0)


def repaired(plan: ReadingPlan, travel: float | None) -> ReadingPlan:
    """Rounding of the held readings taken out by Newton steps of the commands, within
    the workspace.
    """
    for _ in range(6):
        if missed(plan, travel) <= HELD / 10:
            break
        plan = commanded(plan, [_stepped(plan, s, travel) for s in plan.series])
    return plan


def _stepped(plan: ReadingPlan, s: Series, travel: float | None) -> Array:
    """Commands after the least step that puts each reading back on hold to first order."""
    off, command = _off(plan, s, travel), s.command
    if off is None:
        return command
    box = plan.measurement.machine.workspace(plan.setup(s).tool)
    rows, first = s.index[:, 0], np.unique(s.index[:, 0], return_index=True)[1]
    slope = np.zeros((len(s), command.shape[1]))
    for j in range(command.shape[1]):
        ends = []
        for step in (1e-6, -1e-6):
            moved = command.copy()
            moved[rows, j] += step
            side = commanded(ReadingPlan(plan.measurement, (s,)), [moved]).series[0]
            ends.append(
                plan.measurement.readings([side], plan.measurement.nominal).reshape(
                    len(s), -1
                )[:, 0]
            )
        slope[:, j] = (ends[0] - ends[1]) / 2e-6
        at_edge = (command[rows, j] <= box[j].lower + 1e-8) | (
            command[rows, j] >= box[j].upper - 1e-8
        )
        slope[at_edge, j] = 0.0
    size = np.maximum(np.sum(slope**2, axis=1, keepdims=True), 1e-12)
    moved = command.copy()
    moved[rows[first]] -= (off[:, None] * slope / size)[first]
    return np.clip(moved, [c.lower for c in box], [c.upper for c in box])


def fault(
    plan: ReadingPlan,
    variables: Ranges,
    travel: float | None,
    clearance: float | None,
    hold: bool = True,
) -> str | None:
    """What is wrong with a plan, in words; None where nothing is."""
    machine = plan.measurement.machine
    for name, ranges in variables.items():
        now = values(plan.measurement.setups[name])
        for variable, (lower, upper) in ranges.items():
            if not lower <= now[variable] <= upper:
                return f"{variable} of set-up {name} leaves its range"
    for s in plan.series:
        own = s.command[:-1] if plan.taught(s) else s.command
        for _, name, *_ in machine.out_of_range(own, plan.setup(s).tool):
            return f"{name} leaves the workspace"
        for k, joint in enumerate(machine.joints):
            if (
                s.q[:, k].min() < joint.lower - JOINT
                or s.q[:, k].max() > joint.upper + JOINT
            ):
                return f"{joint.name} leaves its range"
        if clearance is not None:
            clear = reading_slopes.pose(machine).clear.map(len(s.q))(s.start.T, s.q.T)
            shares = np.asarray(clear, dtype=float).ravel()
            if shares.size and (
                shares / home_clear(plan.measurement)
            ).min() < clearance * (1 - 1e-6):
                return "a pose is nearer to a singular one than allowed"
    if hold and (miss := missed(plan, travel)) > HELD:
        return f"a held reading is off by {miss:.2g} m"
    return None
