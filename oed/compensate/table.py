"""Tables over a rectilinear grid with multilinear interpolation."""

import dataclasses

import numpy as np
import scipy  # its parts load when first used: checks need no interpolation

from oed.base import Array


@dataclasses.dataclass(frozen=True)
class InterpolationTable:
    """Values on a rectilinear grid; beyond the grid its border values hold."""

    axes: tuple[str, ...]  #: names of the coordinates or states
    knots: tuple[Array, ...]  #: ascending places along each axis, SI
    values: Array  #: (n_1, ..., n_a, m), SI
    #: axes that are a full turn, whose last knot repeats the first; none by default
    turns: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        shape = tuple(len(positions) for positions in self.knots)
        if self.values.shape[:-1] != shape or len(self.axes) != len(shape):
            raise ValueError(
                f"a table over {self.axes} with {shape} knots needs values of that"
                f" shape and one axis more, not {self.values.shape}"
            )
        for name, positions in zip(self.axes, self.knots, strict=True):
            if not (np.diff(positions) > 0.0).all():
                raise ValueError(f"the knots of {name} must ascend")

    def at(self, positions: Array) -> Array:
        """Interpolated values (n, m) at places (n, a)."""
        low = np.array([axis[0] for axis in self.knots])
        high = np.array([axis[-1] for axis in self.knots])
        inside = np.clip(self._reduce_turns(positions, low, high), low, high)
        varied = [k for k, axis in enumerate(self.knots) if len(axis) > 1]
        if not varied:
            return np.repeat(self.values.reshape(1, -1), len(positions), axis=0)
        knots = [self.knots[k] for k in varied]
        shape = [len(axis) for axis in knots]
        values = self.values.reshape(*shape, self.values.shape[-1])
        interpolator = scipy.interpolate.RegularGridInterpolator(knots, values)
        return np.asarray(interpolator(inside[:, varied]))

    def _reduce_turns(self, positions: Array, low: Array, high: Array) -> Array:
        """Places with the angles of full turns between the ends of their axes."""
        reduced = np.array(positions, dtype=float)
        for k in np.flatnonzero(self.turns):
            reduced[:, k] = low[k] + np.mod(reduced[:, k] - low[k], high[k] - low[k])
        return reduced
