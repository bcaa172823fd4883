"""What a plan is for: accuracy of pose components after compensation, over a workspace.

A goal has factors F_k (r, n) over the machine's free parameters in units of their
tolerances, so that component k keeps a root mean square of sqrt(tr F_k S F_k^T) with
the covariance S that a plan leaves, in units of the wanted accuracy (or, where none is
stated, of the accuracy before any reading).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array
from oed.design.criterion import Criterion, Variance, Worst
from oed.measurement import Measurement
from oed.predict import ErrorMaps


@dataclasses.dataclass(frozen=True, eq=False)
class Goal:
    """Components with factors (K, r, n). `unit` (K,) is the accuracy, SI, that counts
    as 1.

    wanted: whether the units are wanted accuracies; then the worst component counts,
    else their mean square.
    """

    names: tuple[str, ...]
    factors: Array
    unit: Array
    wanted: bool

    def accuracy(self, covariance: Array) -> Array:
        """Root mean square (K,) of each component in its unit, from a covariance (n, n)
        in tolerance units.
        """
        told = np.einsum(
            "krn,nm,krm->k", self.factors, covariance, self.factors, optimize=True
        )
        return np.asarray(np.sqrt(np.maximum(told, 0.0)))

    def value(self, covariance: Array) -> float:
        """What a plan is judged by, the smaller the better: the worst, or the mean
        square of the accuracies.
        """
        told = self.accuracy(covariance)
        return float(told.max() if self.wanted else np.sqrt(np.mean(told**2)))

    def criterion(self, more: int) -> Criterion:
        """The same as a criterion of information matrices with `more` columns of set-up
        unknowns at the end.
        """
        wide = np.concatenate(
            [self.factors, np.zeros((*self.factors.shape[:2], more))], axis=2
        )
        if self.wanted:
            return Worst(wide)
        return Variance(wide.reshape(-1, wide.shape[2]) / np.sqrt(len(wide)))


def goal_of(
    measurement: Measurement, maps: ErrorMaps, wanted: dict[str, float]
) -> Goal:
    """A goal about the named components (SI wanted accuracies), or about all of them
    where none is named.

    Raises ValueError for a component that the machine does not have, or that no
    parameter moves.
    """
    keep = len(measurement.machine.parameters)
    free, tolerance = measurement.free[:keep], measurement.tolerance[:keep]
    unknown = set(wanted) - set(maps.names)
    if unknown:
        raise ValueError(
            f"no pose component {sorted(unknown)}: the machine has {list(maps.names)}"
        )
    table = np.transpose(maps.raw * tolerance, (1, 0, 2))[:, :, free] / np.sqrt(
        len(maps.command)
    )
    before = np.sqrt(np.sum(table**2, axis=(1, 2)))
    names = [
        n
        for n in maps.names
        if (n in wanted if wanted else before[maps.names.index(n)] > 0.0)
    ]
    rows = [maps.names.index(n) for n in names]
    unit = np.array([wanted[n] for n in names]) if wanted else before[rows]
    return Goal(
        tuple(names), _triangles(table[rows] / unit[:, None, None]), unit, bool(wanted)
    )


def _triangles(factors: Array) -> Array:
    """The same F^T F with no more rows than columns."""
    if factors.shape[1] <= factors.shape[2]:
        return factors
    return np.array([np.linalg.qr(f, mode="r") for f in factors])
