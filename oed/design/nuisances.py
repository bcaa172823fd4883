"""Unknowns beside the parameters that all readings of a plan share."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array


@dataclasses.dataclass(frozen=True, eq=False)
class Nuisances:
    """Changes of the N numbers that all candidate readings give, by unknown effects.

    columns  (N, u) per unit of each of u unknowns of prior variance 1, SI
    scatter  (N,) standard deviation of what else they change, reading by reading, SI
    """

    columns: Array
    scatter: Array

    @property
    def count(self) -> int:
        """Number u of unknowns."""
        return int(self.columns.shape[1])

    def take(self, rows: slice) -> Nuisances:
        """Those of some numbers."""
        return Nuisances(self.columns[rows], self.scatter[rows])

    def after(self, first: int) -> Nuisances:
        """Those from a number on."""
        return self.take(slice(first, None))

    def weight(self, sigma: Array) -> Array:
        """Share (N,) that scatter leaves of each number's weight, by its noise (N,)."""
        return np.asarray(sigma / np.hypot(sigma, self.scatter))


def no_nuisances(numbers: int) -> Nuisances:
    """Of readings that nothing but parameters and noise changes."""
    return Nuisances(np.zeros((numbers, 0)), np.zeros(numbers))
