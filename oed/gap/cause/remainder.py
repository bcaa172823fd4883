"""Evidence of an unknown remainder: processes orthogonal to the selected effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams
from oed.gap.forms.library import Library

#: how large an unknown may be, against a micrometre
UNKNOWN_SIZES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
#: expected lambda of a form below which its size is taken for none at all
NEGLIGIBLE = 9.0


@dataclasses.dataclass(frozen=True)
class Remainder:
    """The best process of an unknown remainder.

    process         its number
    size            its size
    gram            (d, d) Gram matrix of its columns, orthogonal to the selected effects
    b               (d,) projections of the residual
    log_evidence    of a remainder over none, over all processes and sizes
    """

    process: int
    size: float
    gram: Array
    b: Array
    log_evidence: float


class Remainders:
    """The processes that an unknown remainder may be, under one noise law."""

    def __init__(self, grams: Grams, processes: Library, offset: int) -> None:
        """Lay out the processes, whose columns begin at `offset` in `grams`."""
        self._grams = grams
        self._columns = [atom.columns + offset for atom in processes.atoms]
        self._groups = []
        if self._columns:
            self._groups = evidence.group_by_count(self._columns)
        log_weights = np.array([atom.log_weight for atom in processes.atoms])
        log_share = np.log(max(len(processes.effects), 1))
        log_sizes = log_size_prior(grams, self._columns, UNKNOWN_SIZES)
        self._log_prior = log_weights[:, None] - log_share + log_sizes

    def __len__(self) -> int:
        return len(self._columns)

    def columns_of(self, process: int) -> Index:
        """Columns of a process."""
        return self._columns[process]

    def log_evidences(self, alone: Grams, selected: Index) -> Array:
        """Log evidence (processes, sizes) of each process, over no remainder.

        alone       grams of the selected columns, these in the model
        selected    (k,) columns of the selected effects
        """
        return self._log_evidences(alone, self._orthogonal(selected))

    def best(self, alone: Grams, selected: Index) -> Remainder:
        """The best process and size; arguments as of `log_evidences`."""
        groups = self._orthogonal(selected)
        table = self._log_evidences(alone, groups)
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        numbers, grams, projections = next(g for g in groups if row in g[0])
        place = int(np.flatnonzero(numbers == row)[0])
        return Remainder(
            process=int(row),
            size=float(UNKNOWN_SIZES[column]),
            gram=grams[place],
            b=projections[place],
            log_evidence=float(np.logaddexp.reduce(table, axis=None)),
        )

    def _log_evidences(
        self,
        alone: Grams,
        groups: Sequence[tuple[Index, Array, Array]],
    ) -> Array:
        table = np.empty((len(self._columns), len(UNKNOWN_SIZES)))
        for numbers, gram, b in groups:
            gain, log_det = evidence.explained_energy(gram, b, UNKNOWN_SIZES)
            table[numbers] = alone.log_ratio(gain, log_det)
        return np.asarray(table + self._log_prior)

    def _orthogonal(self, selected: Index) -> list[tuple[Index, Array, Array]]:
        """Processes without what the selected columns could explain.

        Those with as many columns together: their numbers (a,), Gram matrices (a, d, d)
        and projections (a, d).
        """
        gram, b = self._grams.gram, self._grams.b
        root = evidence.visible_root(gram[np.ix_(selected, selected)])
        half, projected = root.T @ gram[selected], root.T @ b[selected]
        groups = []
        for numbers, rows in self._groups:
            over = half[:, rows]
            grams = gram[rows[:, :, None], rows[:, None, :]]
            grams = grams - np.einsum("kad,kae->ade", over, over)
            projections = b[rows] - np.einsum("kad,k->ad", over, projected)
            groups.append((numbers, grams, projections))
        return groups


def log_size_prior(
    grams: Grams,
    choices: Sequence[Index],
    sizes: Array,
) -> Array:
    """Log prior share (choices, sizes) of each size of a choice of columns.

    Sizes that could not be seen are no hypotheses, but for the largest.
    """
    if not choices:
        return np.zeros((0, len(sizes)))
    diagonal = np.diag(grams.gram)
    trace = np.array([diagonal[columns].sum() for columns in choices])
    visible = trace[:, None] * sizes**2 > NEGLIGIBLE
    visible[:, -1] = True
    log_share = -np.log(visible.sum(axis=1, keepdims=True))
    return np.asarray(np.where(visible, log_share, -np.inf))
