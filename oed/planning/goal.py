"""Goal of a plan: accuracy of the pose components after compensation over a workspace.

A goal has factors F_k (r, n) over the machine's free parameters, in units of their
tolerances. With the covariance S that a plan leaves, component k has the root mean
square error sqrt(tr F_k S F_k^T), in units of its target accuracy. Without targets, the
unit is the accuracy before any reading.
"""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Protocol

import numpy as np

from oed.accuracy import ErrorMaps
from oed.base import Array
from oed.design import CRITERIA, Criterion
from oed.measurement import Measurement


@dataclasses.dataclass(frozen=True, eq=False)
class Goal:
    """Pose components with their weights over the machine's parameters."""

    names: tuple[str, ...]  #: (K,) of the components
    factors: Array  #: (K, r, n), in tolerance units and units of `unit`
    unit: Array  #: (K,) accuracy that counts as 1, SI
    #: True: `unit` holds target accuracies, and the worst component counts; False: the
    #: mean square of all components counts
    has_targets: bool
    #: (K,) mean square error that no reading reduces, in units of `unit`; a bound that
    #: leaves it out is a bound as well
    rest: Array | float = 0.0

    @property
    def parameters(self) -> int:
        """Number n of free machine parameters, and of effects beside them."""
        return int(self.factors.shape[2])

    @property
    def least_rest(self) -> float:
        """What `rest` adds to the square of `value`, at least."""
        every = np.broadcast_to(self.rest, len(self.names))
        return float(every.min() if self.has_targets else every.mean())

    def accuracy(self, covariance: Array) -> Array:
        """Root mean square error (K,) in `unit`, from a covariance (n, n)."""
        variance = np.sum((self.factors @ covariance) * self.factors, axis=(1, 2))
        return np.asarray(np.sqrt(np.maximum(variance, 0.0) + self.rest))

    def value(self, covariance: Array) -> float:
        """Value by which plans are judged; smaller is better."""
        return float(self.combine(self.accuracy(covariance)))

    def combine(self, accuracy: Array) -> Array:
        """Value (...) of accuracies (..., K): their maximum or root mean square."""
        if self.has_targets:
            return np.asarray(accuracy.max(axis=-1))
        return np.asarray(np.sqrt(np.mean(accuracy**2, axis=-1)))

    def criterion(self, setup_columns: int) -> Criterion:
        """The goal as a criterion of information matrices (n + setup_columns, ...)."""
        columns = self.parameters + setup_columns
        factors = self._mean_factor[None]
        name = "I"
        if self.has_targets:
            factors = self.factors
            name = "G"
        zeros = np.zeros((*factors.shape[:2], setup_columns))
        return CRITERIA.build(name, columns, np.concatenate([factors, zeros], axis=2))

    @cached_property
    def _mean_factor(self) -> Array:
        """F (r, n) with F^T F the mean of F_k^T F_k over the components."""
        stacked = self.factors.reshape(-1, self.factors.shape[2])
        return np.asarray(_triangles(stacked[None] / np.sqrt(len(self.factors)))[0])


class ToolEffects(Protocol):
    """What effects beside the geometry do to the tool."""

    @property
    def tool(self) -> Array:
        """(poses, k, u) pose errors per unit of each of u effects of prior variance 1, SI."""

    @property
    def others(self) -> Array:
        """(k,) mean square by what no reading reduces, SI."""


def workspace_goal(
    measurement: Measurement,
    maps: ErrorMaps,
    targets: Mapping[str, float],
    effects: ToolEffects | None = None,
) -> Goal:
    """Goal over the workspace of `maps`, for the components with targets.

    targets  {component: accuracy}, SI; empty: all components that a parameter moves
    effects  beside the geometry, on the machine whose accuracy counts

    Raises ValueError for a component that the machine does not have.
    """
    unknown = set(targets) - set(maps.names)
    if unknown:
        raise ValueError(
            f"no pose component {sorted(unknown)}: the machine has {list(maps.names)}"
        )
    parameters = len(measurement.machine.parameters)
    free = measurement.free[:parameters]
    scaled = maps.raw * measurement.tolerance[:parameters]
    jacobian = scaled[:, :, free]
    rest = np.zeros(len(maps.names))
    if effects is not None:
        jacobian = np.concatenate([jacobian, effects.tool], axis=2)
        rest = effects.others
    by_component = np.transpose(jacobian, (1, 0, 2))
    table = by_component / np.sqrt(len(maps.command))
    before = np.sqrt(np.sum(table**2, axis=(1, 2)) + rest)
    if targets:
        names = [name for name in maps.names if name in targets]
    else:
        moved = zip(maps.names, before > 0.0, strict=True)
        names = [name for name, is_moved in moved if is_moved]
    rows = [maps.names.index(name) for name in names]
    unit = np.array([targets[n] for n in names]) if targets else before[rows]
    factors = _triangles(table[rows] / unit[:, None, None])
    return Goal(tuple(names), factors, unit, bool(targets), rest[rows] / unit**2)


def _triangles(factors: Array) -> Array:
    """Factors with the same F^T F and no more rows than columns."""
    if factors.shape[1] <= factors.shape[2]:
        return factors
    return np.array([np.linalg.qr(f, mode="r") for f in factors])
