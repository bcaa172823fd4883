"""Evidence of an unknown remainder: processes orthogonal to the selected effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams
from oed.gap.data.products import ColumnProducts
from oed.gap.forms.library import Library

#: how large an unknown may be, against the noise
UNKNOWN_SIZES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
#: expected lambda of a form below which its size is taken for none at all
NEGLIGIBLE = 9.0


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

    def __init__(self, products: ColumnProducts, processes: Library) -> None:
        """Lay out the processes, in the groups of `groups_of`."""
        self._products = products
        self._columns = [atom.columns for atom in processes.atoms]
        self._groups = groups_of(processes)
        log_weights = np.array([atom.log_weight for atom in processes.atoms])
        log_share = np.log(max(len(processes.effects), 1))
        log_sizes = log_size_prior(
            products.process_diagonal, self._columns, UNKNOWN_SIZES
        )
        self._log_prior = log_weights[:, None] - log_share + log_sizes

    def __len__(self) -> int:
        return len(self._columns)

    def grams_with(self, alone: Grams, selected: Index, process: int) -> Grams:
        """Grams of the selected columns (k,), followed by those of a process.

        alone  grams of the selected columns
        """
        columns = self._columns[process]
        group, row = self._place_of(process)
        cross = self._products.with_processes(selected)[:, columns]
        gram = np.block(
            [[alone.gram, cross], [cross.T, self._products.blocks[group][row]]]
        )
        b = np.concatenate([alone.b, self._products.process_b[columns]])
        return dataclasses.replace(alone, gram=gram, b=b)

    def _place_of(self, process: int) -> tuple[int, int]:
        """Group of a process, and its row in it."""
        for group, (numbers, _) in enumerate(self._groups):
            row = np.flatnonzero(numbers == process)
            if row.size:
                return group, int(row[0])
        raise IndexError(process)

    def log_evidences(self, alone: Grams, selected: Index) -> Array:
        """Log evidence (processes, sizes) of each process, over no remainder.

        alone       grams of the selected columns, these in the model
        selected    (k,) columns of the selected effects
        """
        table = np.empty((len(self._columns), len(UNKNOWN_SIZES)))
        for numbers, gram, b in self._orthogonal(selected):
            gain, log_det = evidence.explained_energy(gram, b, UNKNOWN_SIZES)
            table[numbers] = alone.log_ratio(gain, log_det)
        return np.asarray(table + self._log_prior)

    def best(self, alone: Grams, selected: Index) -> Remainder:
        """The best process and size; arguments as of `log_evidences`."""
        table = self.log_evidences(alone, selected)
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        return Remainder(
            process=int(row),
            size=float(UNKNOWN_SIZES[column]),
            log_evidence=float(np.logaddexp.reduce(table, axis=None)),
        )

    def _orthogonal(self, selected: Index) -> list[tuple[Index, Array, Array]]:
        """Processes without what the selected columns could explain.

        Those with as many columns together: their numbers (a,), Gram matrices (a, d, d)
        and projections (a, d).
        """
        products = self._products
        some = products.grams(selected)
        root = evidence.visible_root(some.gram)
        projected = root.T @ some.b
        cross = root.T @ products.with_processes(selected)
        groups = []
        for (numbers, rows), alone in zip(self._groups, products.blocks, strict=True):
            over = cross[:, rows]
            grams = alone - np.einsum("kad,kae->ade", over, over, optimize=True)
            b = products.process_b[rows] - np.einsum("kad,k->ad", over, projected)
            groups.append((numbers, grams, b))
        return groups


def groups_of(processes: Library) -> list[tuple[Index, Index]]:
    """Processes of as many columns together: their numbers (a,) and columns (a, d)."""
    columns = [atom.columns for atom in processes.atoms]
    return evidence.group_by_count(columns) if columns else []


def log_size_prior(
    energy: Array,
    choices: Sequence[Index],
    sizes: Array,
) -> Array:
    """Log prior share (choices, sizes) of each size of a choice of columns.

    `energy` (K,) is that of each column.
    Sizes that could not be seen are no hypotheses, but for the largest.
    """
    if not choices:
        return np.zeros((0, len(sizes)))
    trace = np.array([energy[columns].sum() for columns in choices])
    visible = trace[:, None] * sizes**2 > NEGLIGIBLE
    visible[:, -1] = True
    log_share = -np.log(visible.sum(axis=1, keepdims=True))
    return np.asarray(np.where(visible, log_share, -np.inf))
