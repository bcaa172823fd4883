"""Products of all forms' columns under one noise law, computed where one is asked for.

An unknown remainder is a process orthogonal to the selected effects.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Sequence

import numpy as np

from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES, UNKNOWN_SIZES
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams, WhitenedColumns
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw

#: columns of each selected effect, with the size of its coefficients
Selected = Sequence[tuple[Index, float]]
_NONE = np.empty(0, dtype=np.intp)
#: how large an unknown may be, against the noise
SIZES = UNKNOWN_SIZES.values


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


@dataclasses.dataclass(frozen=True)
class Remainder:
    """The best process of an unknown remainder.

    process         its number
    size            its size
    log_evidence    of a remainder over none, over all processes and sizes
    """

    process: int
    size: float
    log_evidence: float


class Remainders:
    """The processes that an unknown remainder may be, under one noise law."""

    def __init__(
        self, effects: WhitenedColumns, columns: WhitenedColumns, processes: Library
    ) -> None:
        """Lay out the processes, those with as many columns together."""
        self._effects, self._whitened = effects, columns
        self._columns = [atom.columns for atom in processes.atoms]
        #: numbers (a,), columns (a, d) and Gram matrices (a, d, d)
        self._groups = [
            (numbers, rows, columns.blocks(rows))
            for numbers, rows in evidence.group_by_count(self._columns)
        ]
        log_weights = np.array([atom.log_weight for atom in processes.atoms])
        log_share = np.log(max(len(processes.effects), 1))
        energy = energies(columns.diagonal, self._columns)
        log_sizes = UNKNOWN_SIZES.log_visible_shares(energy)
        #: (processes, sizes) log prior of each
        self.log_prior = log_weights[:, None] - log_share + log_sizes

    def __len__(self) -> int:
        return len(self._columns)

    def log_evidences(self, alone: Grams, selected: Selected) -> Array:
        """Log evidence (processes, sizes) of each process, over no remainder.

        alone       grams of the selected columns, these in the model
        selected    columns of each selected effect, with their size
        """
        table = np.empty((len(self._columns), len(SIZES)))
        taken, projected = self._taken(selected)
        for numbers, rows, blocks in self._groups:
            over = taken[:, rows]
            gram = blocks - np.einsum("kad,kae->ade", over, over, optimize=True)
            b = self._whitened.b[rows] - np.einsum("kad,k->ad", over, projected)
            least = evidence.ROUNDING * self._whitened.whole[rows].max(axis=1)
            gain, log_det = evidence.explained_energy(gram, b, SIZES, least)
            table[numbers] = alone.log_ratio(gain, log_det)
        return np.asarray(table + self.log_prior)

    def best(self, alone: Grams, selected: Selected) -> Remainder:
        """The best process and size; arguments as of `log_evidences`."""
        table = self.log_evidences(alone, selected)
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        return Remainder(
            process=int(row),
            size=float(SIZES[column]),
            log_evidence=float(np.logaddexp.reduce(table, axis=None)),
        )

    def _taken(self, selected: Selected) -> tuple[Array, Array]:
        """Directions that the selected effects could explain, one effect after the other.

        Their products (k, P) with all processes' columns and (k,) with the residual.
        """
        columns = np.concatenate([_NONE, *(c for c, _ in selected)])
        grams = self._effects.grams(columns)
        cross = self._effects.with_others(columns, self._whitened)
        taken, projected = [np.zeros((0, cross.shape[1]))], [np.zeros(0)]
        start = 0
        for own, size in selected:
            rows = np.arange(start, start + len(own))
            start += len(own)
            root = grams.visible_root(rows, size)
            over, residual = root.T @ cross[rows], root.T @ grams.b[rows]
            cross = cross - (grams.gram[:, rows] @ root) @ over
            grams = grams.project_out(rows, size)
            taken.append(over)
            projected.append(residual)
        return np.vstack(taken), np.concatenate(projected)


def energies(diagonal: Array, choices: Sequence[Index]) -> Array:
    """Energy (a,) of each choice of columns, from that of each column (K,)."""
    return np.array([diagonal[columns].sum() for columns in choices])
