"""Noise of readings under one estimated law, for fits and predictions."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.noise.covariance import Noise
from oed.noise.factor import Errors, LinearFactor
from oed.noise.process import Laws, Whitening
from oed.noise.structure import ReadingStructure


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ProcessNoise(Noise):
    """Noise of N readings under a law, SI; whitened in linear time.

    structure   of the readings
    law         whitening of its covariance
    """

    structure: ReadingStructure
    law: Whitening

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        standard = self.structure.standardise(values)
        if values.ndim == 1:
            return np.asarray(self.law.whiten(standard[:, None])[0, :, 0])
        return np.asarray(self.law.whiten(standard)[0])

    def whiten_last(self, values: Array) -> Array:
        """Whitened values (..., N), with readings last."""
        flat = values.reshape(-1, values.shape[-1])
        return self.whiten(flat.T).T.reshape(values.shape)

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        count = int(np.prod(shape[:-1]))
        laws = self.law.laws.take([0] * count)
        errors = Whitening(self.structure, laws).draw(rng)
        return self.structure.restore(errors).reshape(shape)


def process_noise(structure: ReadingStructure, laws: Laws) -> ProcessNoise:
    """Noise under the first of the laws."""
    law = laws.take([0])
    shared = (structure.columns * law.sizes[0, structure.kinds]) ** 2
    sd = law.scale[0, structure.group] * np.sqrt(1.0 + shared.sum(axis=1))
    return ProcessNoise(
        sigma=structure.unit * sd, structure=structure, law=Whitening(structure, law)
    )


def factor_of(structure: ReadingStructure, laws: Laws) -> LinearFactor:
    """Root of the covariance under the first of the laws, over the stated noise."""
    return LinearFactor(errors_of(structure, laws))


def errors_of(structure: ReadingStructure, laws: Laws) -> Errors:
    """Errors of readings under the first of the laws, in units of the stated noise.

    Their shared columns are those of the structure, times their sizes.
    """
    chain = structure.chain
    order = np.lexsort((structure.position, chain))
    ordered, position = chain[order], structure.position[order]
    first = np.diff(ordered, prepend=-1) > 0
    steps = np.diff(position, prepend=0.0)
    carried, place = float(laws.carried[0]), np.arange(len(order))
    decay = np.exp(-np.where(first, np.inf, steps) / laws.reach[0])
    new_run = np.diff(structure.run[ordered], prepend=-1) > 0
    amounts = laws.sizes[0, structure.kinds]
    return Errors(
        order=order,
        starts=np.flatnonzero(new_run),
        before=np.where(first, place, place - 1),
        decay=decay if carried else np.zeros(len(order)),
        single=np.full(len(order), 1.0 - carried),
        carried=carried,
        shared=(structure.columns * amounts)[order],
        scale=laws.scale[0, structure.group][order],
    )
