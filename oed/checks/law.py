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
from oed.noise.law_noise import noise_under
from oed.noise.process import Laws
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
