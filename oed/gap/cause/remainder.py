"""Evidence of an unknown remainder: processes orthogonal to the selected effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams, WhitenedColumns
from oed.gap.forms.library import Library
from oed.model.size_prior import UNKNOWN_SIZES

#: columns of each selected effect, with the size of its coefficients
Selected = Sequence[tuple[Index, float]]
_NONE = np.empty(0, dtype=np.intp)
#: how large an unknown may be, against the noise
SIZES = UNKNOWN_SIZES.values


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
        self._log_prior = log_weights[:, None] - log_share + log_sizes

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
        return np.asarray(table + self._log_prior)

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
