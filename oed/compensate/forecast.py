"""Forecast compensation: an error grid relative to a reference, subtracted in advance.

Chang, Li and Li (2011), section 3: with the errors dX_i at command X_i and dX_0 at the
reference, the drives get X_i' = X_i - (dX_i - dX_0), interpolated linearly between the
nodes of a grid that is dense where the error changes fast.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from oed.base.arrays import Array
from oed.base.text import quantity
from oed.compensate.error_field import ErrorField, Motion
from oed.compensate.table import InterpolationTable, grid_nodes
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL
from oed.model.machine import Machine

#: intervals of the finest grid along an axis, by the number of axes
FINEST = (256, 64, 16, 8)
#: places along an axis at which the prediction is averaged, by the number of axes
EVALUATED = (101, 21, 9, 5)


@dataclasses.dataclass(frozen=True)
class ForecastCompensator:
    """Subtracts the interpolated errors from the commands.

    kinematics  of the machine
    table       errors (..., n_dof) in the command's coordinates, relative to the
                reference; its axes are command coordinates
    predicted   (n_dof,) rms error that it is predicted to leave, SI; None where the
                nodes were read and no field was estimated
    """

    kinematics: Kinematics
    table: InterpolationTable
    predicted: Array | None = None

    def error(self, command: Array) -> Array:
        """Interpolated errors (n, n_dof) at commands (n, n_dof), SI."""
        names = [c.name for c in self.kinematics.machine.command]
        columns = [names.index(name) for name in self.table.axes]
        return self.table.at(command[:, columns])

    def corrected(self, command: Array) -> Array:
        """Commands (n, n_dof) X' = X - (dX - dX_0) to send for X."""
        return command - self.error(command)

    def limits(self, command: Array) -> tuple[str, ...]:
        """What stays uncorrected, in sentences."""
        repeats = (
            "the grid removes errors that come back at the same command in the same"
            " state (temperature, payload, direction); beyond the grid its border holds"
        )
        if self.predicted is None:
            return (repeats,)
        pairs = zip(self.kinematics.machine.command, self.predicted, strict=True)
        parts = [f"{c.name} {quantity(size, c.unit)}" for c, size in pairs]
        return (f"interpolation is predicted to leave {', '.join(parts)} rms", repeats)


def check_forecast(machine: Machine) -> None:
    """Raises ValueError where errors are not read in the command's coordinates."""
    driven = [c.name for c in machine.components if c.compensatable]
    command = [c.name for c in machine.command]
    if driven != command:
        raise ValueError(
            f"machine {machine.name} is commanded in {', '.join(command)}, and its"
            f" errors are stated in {', '.join(driven)}: a grid of errors cannot be"
            " subtracted from commands; use corrected_commands instead"
        )


def strut_motion(kinematics: Kinematics) -> Motion:
    """Motion (n, k, k) of the command coordinates per strut error, at commands.

    A strut's error is its excess length; a machine that states no struts has errors of
    its joints instead. Raises ValueError for machines without such a grid.
    """
    check_forecast(kinematics.machine)
    machine = kinematics.machine
    driven = [k for k, c in enumerate(machine.components) if c.compensatable]
    if len(machine.joints) != len(driven):
        raise ValueError(
            f"machine {machine.name} has {len(machine.joints)} joints for"
            f" {len(driven)} coordinates: errors do not tell which joint caused them"
        )

    def motion(command: Array) -> Array:
        x, q = kinematics.inverse(command)
        by_joint = kinematics.slopes.over_joints(x, q, machine.nominal)
        if machine.struts is not None:
            per_length = kinematics.struts(x, q, machine.nominal)[2]
            by_joint = by_joint * per_length[:, None]
        twist = kinematics.frames(x, NO_TOOL)[2] @ by_joint
        slope = kinematics.error_components_jacobian(command)
        return (slope @ twist)[:, driven]

    return motion


def forecast_from_nodes(
    kinematics: Kinematics, knots: tuple[Array, ...], errors: Array, reference: Array
) -> ForecastCompensator:
    """The compensator of errors (n_1, ..., n_a, n_dof) read at all nodes of a grid.

    knots      along each command coordinate, SI
    reference  (n_dof,) command of the reference

    Raises ValueError for machines without such a grid.
    """
    check_forecast(kinematics.machine)
    axes = tuple(c.name for c in kinematics.machine.command)
    table = InterpolationTable(axes, knots, errors)
    relative = errors - table.at(reference[None])[0]
    return ForecastCompensator(kinematics, InterpolationTable(axes, knots, relative))


def forecast_from_field(
    kinematics: Kinematics, field: ErrorField, reference: Array, tolerance: Array
) -> ForecastCompensator:
    """The compensator of an estimated field of errors.

    reference  (n_dof,) command of the reference
    tolerance  (n_dof,) largest error that the table's interpolation may add, SI

    Raises ValueError for machines without such a grid.
    """
    check_forecast(kinematics.machine)
    knots = refined_knots(field, tolerance)
    at_reference = field.mean(reference[None])[0]
    values = field.mean(grid_nodes(knots)) - at_reference
    shape = tuple(len(places) for places in knots)
    table = InterpolationTable(field.box.names, knots, values.reshape(*shape, -1))
    compensator = ForecastCompensator(kinematics, table)
    predicted = predicted_residual(compensator, field, reference)
    return dataclasses.replace(compensator, predicted=predicted)


def predicted_residual(
    compensator: ForecastCompensator, field: ErrorField, reference: Array
) -> Array:
    """Rms errors (n_dof,) over the box: the field's variance, and the table's errors."""
    axes = len(field.box.names)
    count = EVALUATED[min(axes, len(EVALUATED)) - 1]
    places = grid_nodes(field.box.lattice([count] * axes))
    relative = field.mean(places) - field.mean(reference[None])
    interpolation = relative - compensator.error(places)
    variance = field.sd(places, reference) ** 2 + interpolation**2
    return np.asarray(np.sqrt(variance.mean(axis=0)))


def refined_knots(field: ErrorField, tolerance: Array) -> tuple[Array, ...]:
    """Knots along each axis, halved where the error changes fast.

    The interval in which linear interpolation along its axis is worst is halved until
    the worst ones of all axes together leave less than `tolerance` (n_dof,).
    """
    axes = len(field.box.names)
    count = FINEST[min(axes, len(FINEST)) - 1]
    fine = field.box.lattice([count + 1] * axes)
    values = field.mean(grid_nodes(fine)).reshape(*[count + 1] * axes, -1)
    relative = values / tolerance
    knots = [[0, count] for _ in range(axes)]
    worst = [_interval_errors(relative, axis, knots[axis]) for axis in range(axes)]
    while sum(max(errors) for errors in worst) > 1.0:
        axis = int(np.argmax([max(errors) for errors in worst]))
        k = int(np.argmax(worst[axis]))
        low, high = knots[axis][k : k + 2]
        knots[axis].insert(k + 1, (low + high) // 2)
        worst[axis] = _interval_errors(relative, axis, knots[axis])
    return tuple(places[index] for places, index in zip(fine, knots, strict=True))


def _interval_errors(values: Array, axis: int, knots: list[int]) -> list[float]:
    """Largest error of linear interpolation along an axis, in each interval."""
    along = np.moveaxis(values, axis, 0)
    errors = []
    for low, high in itertools.pairwise(knots):
        share = np.linspace(0.0, 1.0, high - low + 1)
        share = share.reshape(-1, *[1] * (along.ndim - 1))
        line = along[low] + share * (along[high] - along[low])
        errors.append(float(np.abs(along[low : high + 1] - line).max()))
    return errors
