"""One coordinate of commands solved for a reading that an instrument keeps."""

from collections.abc import Callable

import numpy as np

from oed.base import Array, Mask
from oed.measurement import Measurement
from oed.model import Coordinate


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
    from scipy.optimize import elementwise  # takes as long as NumPy to import

    solved = np.array(command, dtype=float)

    def excess(value: Array, row: Array) -> Array:
        poses = solved[row.astype(int)]
        poses[:, column] = value
        return read(poses) - wanted

    n = len(solved)
    root = elementwise.find_root(
        excess,
        (np.full(n, limits.lower), np.full(n, limits.upper)),
        args=(np.arange(n, dtype=float),),
        tolerances={"xatol": 1e-12, "fatol": 1e-13},
    )
    solved[:, column] = root.x
    return solved, root.success


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
            f"{mounted.instrument.name} holds no reading by design: give {coordinate} itself"
        )
    wanted = mounted.instrument.fixed_reading(mounted.settings)
    column = [c.name for c in measurement.machine.command].index(coordinate)
    limits = measurement.machine.workspace(mounted.tool)[column]

    def read(poses: Array) -> Array:
        return measurement.expected_readings(measurement.series(setup, poses))

    return _solve_coordinate(read, wanted, command, column, limits)
