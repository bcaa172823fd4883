"""Array types of the toolkit: real numbers, indices and masks."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


def consecutive_slices(sizes: Sequence[int]) -> tuple[slice, ...]:
    """Slices of these sizes, one after the other."""
    ends = np.cumsum(sizes, dtype=int).tolist()
    return tuple(slice(end - size, end) for size, end in zip(sizes, ends, strict=True))


def grid_nodes(knots: tuple[Array, ...]) -> Array:
    """Nodes (n, a) of a rectilinear grid, the last axis running fastest."""
    mesh = np.meshgrid(*knots, indexing="ij")
    return np.column_stack([axis.ravel() for axis in mesh])
