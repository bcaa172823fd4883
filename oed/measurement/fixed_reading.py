"""One coordinate of commands solved for a reading that an instrument keeps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oed.base import Array, Index, Mask
from oed.measurement import Measurement
from oed.model import Coordinate

#: interval of a coordinate, m or rad, and misfit of a reading, m, at which a root is found
POSITION_TOLERANCE = 1e-12
VALUE_TOLERANCE = 1e-13
#: steps to a root at most: bisection of 1 m needs 40
MAX_STEPS = 200


def _solve_coordinate(
    read: Callable[[Array], Array],
    wanted: float,
    command: Array,
    column: int,
    limits: Coordinate,
) -> tuple[Array, Mask]:
    """Commands (n, n_dof) with one column solved so that `read` gives the wanted value.

    read    readings (n,) at commands (n, n_dof), SI
    limits  range of the column

    Returns them, and the mask (n,) of those that have a solution within the range.
    """
    solved = np.array(command, dtype=float)

    def excess(values: Array, rows: Index) -> Array:
        poses = solved[rows]
        poses[:, column] = values
        return read(poses) - wanted

    ends = (np.full(len(solved), limits.lower), np.full(len(solved), limits.upper))
    solved[:, column] = _find_roots(excess, *ends)
    return solved, np.isfinite(solved[:, column])


def _find_roots(
    function: Callable[[Array, Index], Array], x1: Array, x2: Array
) -> Array:
    """Roots (n,) of `function` at given rows, between ends (n,); NaN where its signs agree.

    Chandrupatla 1997, Adv. Eng. Softw. 28, 145-149: inverse quadratic interpolation where
    that is safe, else bisection. SciPy has it too, in a module that takes longer to import
    than a study takes to check.
    """
    rows, roots = np.arange(len(x1)), np.full(len(x1), np.nan)
    f1, f2 = function(x1, rows), function(x2, rows)
    x3, f3 = x2, f2
    for _ in range(MAX_STEPS):
        best, width = np.where(np.abs(f1) < np.abs(f2), x1, x2), np.abs(x2 - x1)
        is_bracket = np.sign(f1) * np.sign(f2) <= 0.0
        is_done = np.minimum(np.abs(f1), np.abs(f2)) <= VALUE_TOLERANCE
        is_done |= is_bracket & (width <= POSITION_TOLERANCE)
        roots[rows[is_done]] = best[is_done]
        going = is_bracket & ~is_done
        if not going.any():
            break
        rows = rows[going]
        x1, f1, x2, f2, x3, f3 = np.array([x1, f1, x2, f2, x3, f3])[:, going]
        with np.errstate(divide="ignore", invalid="ignore"):  # x3 = x2 at first
            xi, phi = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
            is_safe = (1.0 - np.sqrt(1.0 - xi) < phi) & (phi < np.sqrt(xi))
            further = (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f2 - f3)
            share = f1 / (f1 - f2) * f3 / (f3 - f2) - further
        least = 0.5 * POSITION_TOLERANCE / width[going]
        share = np.clip(np.where(is_safe, share, 0.5), least, 1.0 - least)
        x = x1 + share * (x2 - x1)
        f = function(x, rows)
        is_same = np.sign(f) == np.sign(f1)
        x3, f3 = np.where(is_same, x1, x2), np.where(is_same, f1, f2)
        x2, f2 = np.where(is_same, x2, x1), np.where(is_same, f2, f1)
        x1, f1 = x, f
    return roots


def commands_at_fixed_reading(
    measurement: Measurement, setup: str, command: Array, coordinate: str
) -> tuple[Array, Mask]:
    """Solve one command coordinate for the reading that the instrument keeps.

    A ball bar of fixed length leads the tool on a sphere about its cup. Returns
    the commands (n, n_dof), and the mask (n,) of those that have a solution within
    the coordinate's range. Raises ValueError where the instrument keeps no reading.
    """
    mounted = measurement.setups[setup]
    if mounted.instrument.fixed_reading is None:
        raise ValueError(
            f"{mounted.instrument.name} holds no reading by design: give"
            f" {coordinate} itself"
        )
    wanted = mounted.instrument.fixed_reading(mounted.settings)
    column = [c.name for c in measurement.machine.command].index(coordinate)
    limits = measurement.machine.workspace(mounted.tool)[column]

    def read(poses: Array) -> Array:
        return measurement.expected_readings(measurement.series(setup, poses))

    return _solve_coordinate(read, wanted, command, column, limits)
