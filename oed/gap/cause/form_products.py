"""Products of all forms' columns under one noise law, computed where one is asked for."""

from __future__ import annotations

import functools
from collections.abc import Collection

import numpy as np

from oed.base.arrays import Array
from oed.gap.cause.remainder import Remainders, energies
from oed.gap.data.evidence import Grams, WhitenedColumns
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.model.size_prior import EFFECT_SIZES
from oed.noise.law import NoiseLaw


class FormProducts:
    """Products, remainders and priors of forms, kept until `release`."""

    def __init__(
        self,
        problem: GapProblem,
        library: Library,
        processes: Library,
        law: NoiseLaw,
        effects: Collection[str],
    ) -> None:
        """Of a library's forms, and of processes; `effects` are those in question."""
        self._problem, self._law = problem, law
        self._library, self._processes = library, processes
        forms = [atom.columns for atom in library.atoms if atom.effect in effects]
        #: numbers of the columns of the effects in question
        self._needed = np.unique(np.concatenate([np.empty(0, dtype=np.intp), *forms]))

    @functools.cached_property
    def metric(self) -> Metric:
        """The metric of the law."""
        return Metric(self._problem, self._law)

    @functools.cached_property
    def effects(self) -> WhitenedColumns:
        """Columns of the effects in question."""
        columns = self._library.columns
        return WhitenedColumns(self._problem, self.metric, columns, self._needed)

    @functools.cached_property
    def remainders(self) -> Remainders:
        """The processes that an unknown remainder may be."""
        columns = WhitenedColumns(self._problem, self.metric, self._processes.columns)
        return Remainders(self.effects, columns, self._processes)

    @functools.cached_property
    def grams(self) -> Grams:
        """Grams of all columns of all effects."""
        columns = self._library.columns
        if len(self._needed) == columns.shape[1]:
            return self.effects.grams()
        return WhitenedColumns(self._problem, self.metric, columns).grams()

    @functools.cached_property
    def log_prior(self) -> Array:
        """Log prior (atoms, sizes) of each form of the effects in question."""
        return self._log_prior(self.effects.diagonal)

    @functools.cached_property
    def log_prior_of_all(self) -> Array:
        """The same of each form of all effects."""
        return self._log_prior(self.grams.gram.diagonal())

    def _log_prior(self, diagonal: Array) -> Array:
        atoms = self._library.atoms
        log_weights = np.array([atom.log_weight for atom in atoms])
        energy = energies(diagonal, [atom.columns for atom in atoms])
        return log_weights[:, None] + EFFECT_SIZES.log_visible_shares(energy)

    def release(self) -> None:
        """Give the memory back; what is asked for again is computed again."""
        for name in ("metric", "effects", "remainders", "grams"):
            self.__dict__.pop(name, None)
