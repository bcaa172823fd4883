"""Series driven to other poses: other commands in the file's rows, other joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from oed.base import Array, Mask
from oed.checks.mistakes.moved import Moved
from oed.measurement import Measurement, Series
from oed.model import Machine

#: a full turn, rad
TURN = 2.0 * np.pi
#: share of a coordinate's range that rounding may exceed
RANGE_TOLERANCE = 1e-9
#: commands or joints (n, k) in place of others
Change = Callable[[Array], Array]


def commanded(
    measurement: Measurement, change: Change, *, rows: str = "file", slack: float = 0.0
) -> Moved:
    """Change the commands (n, n_dof) of a series that recorded them.

    rows   `file` for those in the file's rows, `teach` for the teach pose, `all`
    slack  share of a coordinate's range by which it may be exceeded; commands outside
           the workspace were never given, but a machine may have stood there
    """
    machine = measurement.machine

    def moved(series: Series) -> Series | None:
        setup = measurement.setups[series.setup]
        if not np.isfinite(series.command).all():
            return None
        changed = _rows(series, rows, is_taught=setup.teach is not None)
        if not changed.any():
            return None
        command = series.command.copy()
        command[changed] = wrapped(change(command[changed]), machine)
        if not inside(command[changed], machine, setup.tool, slack):
            return None
        x, q = measurement.kinematics.sent(command, np.array(setup.tool))
        return dataclasses.replace(series, q=q, start=x, command=command)

    return moved


def inside(
    command: Array, machine: Machine, tool: Sequence[float], slack: float
) -> bool:
    """Whether no command is outside the workspace by more than a share of it."""
    for value, coordinate in zip(command.T, machine.workspace(tool), strict=True):
        span = coordinate.upper - coordinate.lower
        room = (slack + RANGE_TOLERANCE) * span if np.isfinite(span) else 0.0
        below, above = coordinate.lower - value.min(), value.max() - coordinate.upper
        if max(below, above) > room:
            return False
    return True


def _rows(series: Series, rows: str, *, is_taught: bool) -> Mask:
    """Poses (m,) that are commanded in the file's rows, the teach pose, or all."""
    of_file = in_file(series, is_taught=is_taught)
    if rows == "teach":
        return ~of_file
    return of_file if rows == "file" else np.ones_like(of_file)


def in_file(series: Series, *, is_taught: bool) -> Mask:
    """Poses (m,) that are commanded in the file's rows."""
    of_file = np.ones(len(series.command), dtype=bool)
    if is_taught:
        of_file[:] = False
        of_file[series.index[:, 0]] = True
    return of_file


def jointed(measurement: Measurement, change: Change) -> Moved:
    """Series whose joints (m, nq) are changed; their poses are followed from home."""
    kinematics = measurement.kinematics

    def moved(series: Series) -> Series | None:
        q = change(series.q)
        x = kinematics.start_poses(q, patient=False)
        return dataclasses.replace(series, q=q, start=x)

    return moved


def wrapped(command: Array, machine: Machine) -> Array:
    """Commands (n, n_dof) with angles that turn freely brought into their range."""
    turned = command.copy()
    for k, coordinate in enumerate(machine.command):
        if coordinate.unit == "rad" and turns_freely(
            coordinate.lower, coordinate.upper
        ):
            turned[:, k] -= TURN * np.floor((turned[:, k] - coordinate.lower) / TURN)
    return turned


def turns_freely(lower: float, upper: float) -> bool:
    """Whether an angle's range is a full turn."""
    span = upper - lower
    return bool(np.isfinite(span) and span >= TURN * (1.0 - RANGE_TOLERANCE))


def of_column(k: int, meant: Change) -> Change:
    """Column k (n,) changed. NaN, which is no pose, raises ValueError later on."""

    def change(values: Array) -> Array:
        changed = values.copy()
        changed[:, k] = meant(values[:, k])
        return changed

    return change


def shifted(k: int, amount: float) -> Change:
    """Column k plus an amount, SI."""
    return of_column(k, lambda values: values + amount)


def exchanged(count: int, one: int, other: int) -> tuple[int, ...]:
    """The order of some columns with two of them exchanged."""
    order = list(range(count))
    order[one], order[other] = other, one
    return tuple(order)


def permuted(order: Sequence[int], signs: ArrayLike = 1.0) -> Change:
    """Columns in another order, with signs."""
    return lambda values: values[:, list(order)] * np.asarray(signs)
