"""Assessment of planned readings: which parameters they determine, and how well.

The assessment needs no reading, only the slopes H of the readings over the parameters.
`oed.identifiability.identifiability` finds rank and null directions of H, `oed.identifiability.information` the
posterior covariance; `oed.identifiability.explain` puts the result into sentences.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.identifiability import identifiability, information
from oed.identifiability.identifiability import Identifiability
from oed.measurement.measurement import Measurement, Series


@dataclasses.dataclass(frozen=True)
class Assessment:
    """What a set of readings determines. All arrays are over the n free parameters.

    measurement      machine and set-ups
    series           the readings
    identifiability  rank, combinations and null directions of the scaled H
    scale            (n,) factor by which each column of H was multiplied
    shrinkage        (n,) posterior over prior standard deviation
    covariance       (n, n) posterior covariance, in units of the tolerances
    """

    measurement: Measurement
    series: tuple[Series, ...]
    identifiability: Identifiability
    scale: Array
    shrinkage: Array
    covariance: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names (n,) of the free parameters."""
        return self.identifiability.names


def assess(
    measurement: Measurement,
    series: Sequence[Series],
    scaling: information.Scaling = "length",
) -> Assessment:
    """Assess readings of the nominal machine.

    Parameters of set-ups that `series` does not use are left out. `scaling` holds for
    the rank; shrinkage and covariance always use the tolerances. Raises AssemblyError
    where a pose cannot be assembled or is singular.
    """
    theta = measurement.nominal
    free = free_parameters(measurement, series)
    h = information.scaled(measurement, series, theta, scaling)[:, free]
    whitened = information.scaled(measurement, series, theta, "tolerance")[:, free]
    scale = information.column_scale(measurement, scaling)[free]
    covariance = information.posterior_covariance(whitened)
    names = [measurement.names[k] for k in free]
    return Assessment(
        measurement=measurement,
        series=tuple(series),
        identifiability=identifiability.analyse(h, names, scale),
        scale=scale,
        shrinkage=np.sqrt(np.diag(covariance)),
        covariance=covariance,
    )


def free_parameters(measurement: Measurement, series: Sequence[Series]) -> Index:
    """Indices of the free parameters of the machine and of the set-ups in use."""
    setups = {s.setup for s in series}
    indices = []
    for k, name in enumerate(measurement.names):
        setup, _, _ = name.rpartition(".")
        if measurement.free[k] and (not setup or setup in setups):
            indices.append(k)
    return np.array(indices, dtype=np.intp)
