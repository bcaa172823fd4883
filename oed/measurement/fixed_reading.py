"""One coordinate of commands solved for a reading that an instrument keeps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import elementwise

from oed.base.arrays import Array, Mask
from oed.model.machine import Coordinate


def solve_coordinate(
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
    return solved, np.asarray(root.success)
