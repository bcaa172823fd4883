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
#: expected lambda of a form below which no reading shows it
NEGLIGIBLE = 9.0


@dataclasses.dataclass(frozen=True)
class Remainder:
    """The best process of an unknown remainder.

    process         its number
    size            its size
    log_evidence    of a remainder over none, over all processes and sizes
    unseen          share of the evidence at sizes that no reading shows
    """

    process: int
    size: float
    log_evidence: float
    unseen: float


class Remainders:
    """The processes that an unknown remainder may be, under one noise law."""

    def __init__(self, products: ColumnProducts, processes: Library) -> None:
        """Lay out the processes, in the groups of `groups_of`."""
        self._products = products
        self._columns = [atom.columns for atom in processes.atoms]
        self._groups = groups_of(processes)
        log_weights = np.array([atom.log_weight for atom in processes.atoms])
        log_share = np.log(max(len(processes.effects), 1))
        self._prior = SizePrior(
            log_weights - log_share,
            expected_energy(products.process_diagonal, self._columns),
            UNKNOWN_SIZES,
        )

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
        return np.asarray(table + self._prior.table(alone=not len(selected)))

    def best(self, alone: Grams, selected: Index) -> Remainder:
        """The best process and size; arguments as of `log_evidences`."""
        table = self.log_evidences(alone, selected)
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        total = float(np.logaddexp.reduce(table, axis=None))
        unseen = np.exp(table[~self._prior.seen] - total).sum()
        return Remainder(int(row), float(UNKNOWN_SIZES[column]), total, float(unseen))

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


def expected_energy(energy: Array, choices: Sequence[Index]) -> Array:
    """Expected energy (choices,) of columns with coefficients N(0, 1).

    `energy` (K,) is that of each column.
    """
    return np.array([energy[columns].sum() for columns in choices])


class SizePrior:
    """Prior of forms at each size: sizes are equally likely.

    A gap that no reading shows is a gap all the same. But beside another effect, a form
    that no reading shows would change nothing that is said: it has the sizes that show.
    """

    def __init__(self, log_weights: Array, energy: Array, sizes: Array) -> None:
        """Lay out the prior.

        log_weights   (forms,) log prior of each form
        energy        (forms,) expected energy of each form at size 1
        """
        #: (forms, sizes) which are seen by the readings; the largest always counts
        self.seen = energy[:, None] * sizes**2 > NEGLIGIBLE
        self.seen[:, -1:] = True
        self._alone = np.tile(log_weights[:, None] - np.log(len(sizes)), len(sizes))
        log_share = log_weights - np.log(self.seen.sum(axis=1))
        self._further = np.where(self.seen, log_share[:, None], -np.inf)

    def table(self, *, alone: bool) -> Array:
        """Log prior (forms, sizes) of forms that act alone, or with others."""
        return self._alone if alone else self._further
