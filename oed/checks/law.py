"""The noise law by which readings are checked: estimated from them, as a fit does.

A law that relates readings (an error of a run, one that is carried along) is no misfit.
How far single readings scatter is judged against the stated noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.base.arrays import Array
from oed.measurement.measurement import Measurement, Series
from oed.measurement.reading_structure import reading_structure
from oed.noise.covariance import Noise
from oed.noise.factor import LinearFactor
from oed.noise.process import Laws
from oed.noise.process_noise import errors_of
from oed.noise.structure import ReadingStructure


@dataclasses.dataclass(frozen=True, eq=False)
class CheckedLaw:
    """A noise law that is not tied to a set of readings.

    scale  of each group of readings, `set-up.channel`, over the stated noise
    law    its other numbers, as one of some laws
    theta  (n,) parameters at which slopes over renewed unknowns are taken
    """

    scale: Mapping[str, float]
    law: Laws
    theta: Array

    def noise(self, measurement: Measurement, series: Sequence[Series]) -> Noise:
        """The noise of readings under the law, SI."""
        theta = self.theta
        if len(theta) != len(measurement.nominal):
            theta = measurement.nominal
        structure = reading_structure(measurement, series, theta)
        return noise_under(structure, self.laws(structure))

    def laws(self, structure: ReadingStructure) -> Laws:
        """The law for readings of a structure; groups it does not know are as stated."""
        scale = np.array([[self.scale.get(name, 1.0) for name in structure.names]])
        return dataclasses.replace(self.law, scale=scale)

    def with_scale(self, least: float, most: float) -> CheckedLaw:
        """The law with scales no smaller and no larger than these."""
        scale = {k: float(np.clip(v, least, most)) for k, v in self.scale.items()}
        return dataclasses.replace(self, scale=scale)

    def size(self, structure: ReadingStructure) -> float:
        """Standard deviation of a reading over the stated one, of the group that has
        most.
        """
        laws = self.laws(structure)
        shared = (structure.columns * laws.sizes[0, structure.kinds]) ** 2
        stated = (structure.columns**2)[:, structure.kinds == 1].sum(axis=1)
        scale = laws.scale[0, structure.group]
        ratio = scale * np.sqrt((1.0 + shared.sum(axis=1)) / (1.0 + stated))
        return float(ratio.max())


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LawNoise(Noise):
    """Noise of N readings under a law, SI.

    structure  of the readings
    factor     of the covariance over the stated noise
    """

    structure: ReadingStructure
    factor: LinearFactor

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        standard = self.structure.standardise(values)
        wide = standard[:, None] if values.ndim == 1 else standard
        return self.factor.whiten(wide).reshape(values.shape)

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        wide = values[:, None] if values.ndim == 1 else values
        back = self.factor.whiten_back(wide)
        if self.structure.decouple is not None:
            back = np.asarray(self.structure.decouple.T @ back)
        else:
            back = back / self.structure.unit[:, None]
        return back.reshape(values.shape)

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1; channels share no error but those of a reading."""
        diagonal = self.factor.precision_diagonal()
        if self.structure.decouple is None:
            return diagonal / self.structure.unit**2
        return np.asarray(self.structure.decouple.power(2).T @ diagonal)


def noise_under(structure: ReadingStructure, laws: Laws) -> LawNoise:
    """Noise of readings under the first of some laws, SI, with its precision."""
    shared = (structure.columns * laws.sizes[0, structure.kinds]) ** 2
    sd = laws.scale[0, structure.group] * np.sqrt(1.0 + shared.sum(axis=1))
    factor = LinearFactor(errors_of(structure, laws))
    return LawNoise(structure.unit * sd, structure=structure, factor=factor)
