"""A plan of readings that can be moved to other commands, restored to hold, and checked.

All numbers come from `oed.measurement.measurement`. Nothing here depends on the programme that
found a plan (`oed.design.polish`): what it reports is computed anew.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.base import Array
from oed.design import reading_slopes
from oed.design.reading_slopes import TOOL
from oed.measurement import Measurement, Series
from oed.model.instrument import Setup

#: by how much a held reading (m, rad) and a joint may miss in the end
HOLD_TOLERANCE, JOINT_TOLERANCE = 1e-9, 1e-9
#: Newton steps that restore the hold, and step of their differences (m, rad)
RESTORE_STEPS, DIFFERENCE = 6, 1e-6
#: a command nearer than this to the edge of the workspace is not moved
EDGE = 1e-8

#: set-up -> variable -> range, SI
Ranges = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class ReadingPlan:
    """Readings with the measurement they belong to."""

    measurement: Measurement
    series: tuple[Series, ...]

    def setup(self, series: Series) -> Setup:
        """Set-up of a series."""
        return self.measurement.setups[series.setup]

    def has_teach_pose(self, series: Series) -> bool:
        """Whether the last pose of a series is its teach pose."""
        return self.setup(series).teach is not None


def tool_shift(measurement: Measurement) -> Array:
    """(n_dof, 3): by how much a tool moves each command coordinate."""
    names = [c.name for c in measurement.machine.command]
    return np.array([[float(name == axis) for axis in "xyz"] for name in names])


def settings_and_tool(setup: Setup) -> dict[str, float]:
    """Settings and tool of a set-up by name, SI."""
    return {**setup.settings, **dict(zip(TOOL, setup.tool, strict=True))}


def at_commands(plan: ReadingPlan, commands: Sequence[Array]) -> ReadingPlan:
    """The readings at other commands (m, n_dof), teach poses unchanged.

    Raises AssemblyError for commands out of reach.
    """
    moved = []
    for series, command in zip(plan.series, commands, strict=True):
        command = command.copy()
        setup = plan.setup(series)
        if plan.has_teach_pose(series):
            command[-1] = setup.teach
        x, q = plan.measurement.kinematics.sent(command, np.array(setup.tool))
        moved.append(dataclasses.replace(series, q=q, start=x, command=command))
    return ReadingPlan(plan.measurement, tuple(moved))


def home_determinant(measurement: Measurement) -> float:
    """det phi_x at home, with its sign; not for redundant machines."""
    machine = measurement.machine
    x, q = measurement.kinematics.inverse(machine.home_command)
    return float(reading_slopes.symbolic_pose(machine).determinant(x[0], q[0]))


# -- readings that the instrument holds ------------------------------------------------


def _first_channel(measurement: Measurement, series: Series) -> Array:
    """First channel (n,) of the readings of a series on the nominal machine."""
    readings = measurement.readings([series], measurement.nominal)
    return readings.reshape(len(series), -1)[:, 0]


def _hold_errors(
    plan: ReadingPlan, series: Series, travel: float | None
) -> Array | None:
    """Distance (n,) of readings from the value held, beyond the travel.

    None where the instrument holds nothing.
    """
    setup = plan.setup(series)
    if setup.instrument.fixed_reading is None:
        return None
    reading = _first_channel(plan.measurement, series)
    error = reading - setup.instrument.fixed_reading(setup.settings)
    return error - np.clip(error, -(travel or 0.0), travel or 0.0)


def largest_hold_error(plan: ReadingPlan, travel: float | None) -> float:
    """Largest distance (m, rad) of a reading from the value held, beyond the travel."""
    errors = [_hold_errors(plan, series, travel) for series in plan.series]
    largest = [float(np.abs(e).max()) for e in errors if e is not None]
    return max(largest, default=0.0)


def restore_hold(plan: ReadingPlan, travel: float | None) -> ReadingPlan:
    """The plan after Newton steps of the commands that remove rounding of held readings.

    The commands stay within the workspace.
    """
    for _ in range(RESTORE_STEPS):
        if largest_hold_error(plan, travel) <= HOLD_TOLERANCE / 10:
            break
        commands = [_newton_step(plan, series, travel) for series in plan.series]
        plan = at_commands(plan, commands)
    return plan


def _newton_step(plan: ReadingPlan, series: Series, travel: float | None) -> Array:
    """Commands after the least step that restores each reading's hold to first order."""
    error, command = _hold_errors(plan, series, travel), series.command
    if error is None:
        return command
    box = plan.measurement.machine.workspace(plan.setup(series).tool)
    lower, upper = [c.lower for c in box], [c.upper for c in box]
    rows = series.index[:, 0]
    first = np.unique(rows, return_index=True)[1]
    slope = _command_slopes(plan, series)
    at_lower = command[rows] <= np.array(lower) + EDGE
    at_upper = command[rows] >= np.array(upper) - EDGE
    slope[at_lower | at_upper] = 0.0
    square = np.maximum(np.sum(slope**2, axis=1, keepdims=True), 1e-12)
    moved = command.copy()
    moved[rows[first]] -= (error[:, None] * slope / square)[first]
    return np.clip(moved, lower, upper)


def _command_slopes(plan: ReadingPlan, series: Series) -> Array:
    """Slopes (n, n_dof) of the readings along their commands, by differences."""
    single = ReadingPlan(plan.measurement, (series,))
    rows, command = series.index[:, 0], series.command
    slope = np.zeros((len(series), command.shape[1]))
    for j in range(command.shape[1]):
        ends = []
        for step in (DIFFERENCE, -DIFFERENCE):
            moved = command.copy()
            moved[rows, j] += step
            moved_series = at_commands(single, [moved]).series[0]
            ends.append(_first_channel(plan.measurement, moved_series))
        slope[:, j] = (ends[0] - ends[1]) / (2 * DIFFERENCE)
    return slope


# -- checks ----------------------------------------------------------------------------


def find_fault(
    plan: ReadingPlan,
    variables: Ranges,
    travel: float | None,
    clearance: float | None,
    hold: bool = True,
) -> str | None:
    """The first fault of a plan, in words; None where it has none.

    `clearance` is the least determinant as a share of that at home.
    """
    for name, ranges in variables.items():
        current = settings_and_tool(plan.measurement.setups[name])
        for variable, (lower, upper) in ranges.items():
            if not lower <= current[variable] <= upper:
                return f"{variable} of set-up {name} leaves its range"
    for series in plan.series:
        fault = _range_fault(plan, series)
        if fault is None and clearance is not None:
            fault = _singularity_fault(plan, series, clearance)
        if fault is not None:
            return fault
    if hold and (error := largest_hold_error(plan, travel)) > HOLD_TOLERANCE:
        return f"a held reading is off by {error:.2g} m"
    return None


def _range_fault(plan: ReadingPlan, series: Series) -> str | None:
    """A coordinate or a joint that leaves its range."""
    machine = plan.measurement.machine
    command = series.command
    if plan.has_teach_pose(series):
        command = command[:-1]
    for _, name, *_ in machine.out_of_range(command, plan.setup(series).tool):
        return f"{name} leaves the workspace"
    for k, joint in enumerate(machine.joints):
        least, largest = series.q[:, k].min(), series.q[:, k].max()
        below = least < joint.lower - JOINT_TOLERANCE
        if below or largest > joint.upper + JOINT_TOLERANCE:
            return f"{joint.name} leaves its range"
    return None


def _singularity_fault(
    plan: ReadingPlan, series: Series, clearance: float
) -> str | None:
    """Poses too near to a singular one."""
    determinant = reading_slopes.symbolic_pose(plan.measurement.machine).determinant
    values = determinant.map(len(series.q))(series.start.T, series.q.T)
    determinants = np.asarray(values, dtype=float).ravel()
    if not determinants.size:
        return None
    shares = determinants / home_determinant(plan.measurement)
    if shares.min() < clearance * (1 - 1e-6):
        return "a pose is nearer to a singular one than allowed"
    return None
