"""Noise of readings under one estimated law, for fits, checks and predictions."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from oed.base.arrays import Array
from oed.noise.covariance import Noise
from oed.noise.factor import Errors, LinearFactor
from oed.noise.process import Laws, Whitening
from oed.noise.structure import ReadingStructure


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LawNoise(Noise):
    """Noise of N readings under a law, SI.

    structure  of the readings
    law        the law, one of some laws
    """

    structure: ReadingStructure
    law: Laws

    @functools.cached_property
    def _factor(self) -> LinearFactor:
        """Root of the covariance over the stated noise."""
        return factor_of(self.structure, self.law)

    def whiten(self, values: Array) -> Array:
        """Whitened values: (N,), (N, n), with readings first."""
        standard = self.structure.standardise(values)
        wide = standard[:, None] if values.ndim == 1 else standard
        return self._factor.whiten_in_place(wide).reshape(values.shape)

    def whiten_back(self, values: Array) -> Array:
        """W^T Y, for Y (N,) or (N, n)."""
        wide = values[:, None] if values.ndim == 1 else values
        back = self._factor.whiten_back(wide[self._factor.order])
        if self.structure.decouple is not None:
            back = self.structure.decouple.T @ back
        else:
            back = back / self.structure.unit[:, None]
        return back.reshape(values.shape)

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of Sigma^-1; channels share no error but those of a reading."""
        diagonal = self._factor.precision_diagonal()
        if self.structure.decouple is None:
            return np.asarray(diagonal / self.structure.unit**2)
        return np.asarray(self.structure.decouple.power(2).T @ diagonal)

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        laws = self.law.take([0] * int(np.prod(shape[:-1])))
        errors = Whitening(self.structure, laws).draw(rng)
        return self.structure.restore(errors).reshape(shape)


def noise_under(structure: ReadingStructure, laws: Laws) -> LawNoise:
    """Noise of readings under the first of some laws, SI."""
    law = laws.take([0])
    shared = (structure.columns * law.sizes[0, structure.kinds]) ** 2
    sd = law.scale[0, structure.group] * np.sqrt(1.0 + shared.sum(axis=1))
    return LawNoise(structure.unit * sd, structure=structure, law=law)


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
