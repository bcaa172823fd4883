"""Choice of N readings out of candidates by exchange.

Fedorov (1972): replacing reading i by candidate j changes det M by the factor

    (1 - d_ii) (1 + d_jj) + d_ij^2,       d_ij = h_i^T M^-1 h_j,

which is exact, so each step takes the best of all pairs. Restarts from random subsets; the best end point counts.
For E the pairs are ranked to first order along the smallest eigenvectors and the best are computed exactly.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oed import criteria
from oed.batch import Array

Index = NDArray[np.intp]
#: pairs computed exactly in one step of the E exchange
SHORTLIST = 64
#: relative gain below which an exchange counts as done
GAIN = 1e-9


@dataclasses.dataclass(frozen=True)
class Choice:
    """Chosen candidates (indices, ascending) and the criterion's value over the directions that can be seen."""

    indices: Index
    criterion: str
    value: float
    directions: int


def choose(
    rows: Array,
    size: int,
    rng: np.random.Generator,
    criterion: Literal["D", "E"] = "D",
    prior: Array | None = None,
    starts: int = 20,
    tolerance: float = 1e-6,
) -> Choice:
    """Choose `size` different candidates out of rows (C, n), whitened and scaled.

    prior (n, n) is information held already. Without one, the design lives in the directions that the
    candidates together can see (singular values above `tolerance` of the largest): no plan sees more. Raises
    ValueError where there are too few candidates, or fewer readings than directions.
    """
    if not 0 < size <= len(rows):
        raise ValueError(f"cannot choose {size} different readings out of {len(rows)} candidates")
    if criterion not in ("D", "E"):
        raise ValueError(f"exchange knows the criteria D and E, not {criterion!r}")
    if prior is None:
        rows = seen(rows, tolerance)
        base = np.zeros((rows.shape[1], rows.shape[1]))
        if size < rows.shape[1]:
            raise ValueError(f"{size} readings cannot determine the {rows.shape[1]} directions the candidates see")
    else:
        base = prior
    ends = []
    for _ in range(starts):
        chosen = _improve_d(rows, _start(rows, size, base, rng), base)
        if criterion == "E":
            chosen = _improve_e(rows, chosen, base)
        ends.append((_value(rows[chosen], base, criterion), chosen))
    value, chosen = max(ends, key=lambda end: end[0])
    return Choice(np.sort(chosen), criterion, value, rows.shape[1])


def seen(rows: Array, tolerance: float = 1e-6) -> Array:
    """Rows in an orthonormal basis of the directions they see (C, r); determinants keep their value."""
    _, s, vt = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(rows @ vt[s > tolerance * s[0]].T)


def _value(rows: Array, base: Array, criterion: str) -> float:
    information = rows.T @ rows + base
    return criteria.d(information) if criterion == "D" else criteria.e(information)


def _start(rows: Array, size: int, base: Array, rng: np.random.Generator) -> Index:
    """A random half, filled up greedily: each next reading is the one whose variance is largest."""
    chosen = list(rng.choice(len(rows), size=max(1, size // 2), replace=False))
    ridge = 1e-9 * float(np.mean(np.sum(rows**2, axis=1))) * np.eye(rows.shape[1])
    inverse = np.linalg.inv(rows[chosen].T @ rows[chosen] + base + ridge)
    while len(chosen) < size:
        projected = rows @ inverse
        variance = np.sum(projected * rows, axis=1)
        variance[chosen] = -np.inf
        best = int(np.argmax(variance))
        chosen.append(best)
        inverse -= np.outer(projected[best], projected[best]) / (1.0 + variance[best])
    return np.array(chosen, dtype=np.intp)


def _improve_d(rows: Array, chosen: Index, base: Array) -> Index:
    chosen = chosen.copy()
    while True:
        inverse = np.linalg.inv(rows[chosen].T @ rows[chosen] + base)
        projected = rows @ inverse
        own = np.sum(projected * rows, axis=1)
        factor = (1.0 - own[chosen])[:, None] * (1.0 + own)[None, :] + (projected[chosen] @ rows.T) ** 2
        factor[:, chosen] = 0.0
        i, j = np.unravel_index(int(np.argmax(factor)), factor.shape)
        if factor[i, j] <= 1.0 + GAIN:
            return chosen
        chosen[i] = j


def _improve_e(rows: Array, chosen: Index, base: Array) -> Index:
    chosen = chosen.copy()
    while True:
        information = rows[chosen].T @ rows[chosen] + base
        values, vectors = np.linalg.eigh(information)
        # soft minimum: pairs are ranked by what they do to all small eigenvalues, not to the last alone
        weight = (values[0] / values) ** 4
        along = (rows @ vectors) ** 2 @ weight
        gain = along[None, :] - along[chosen][:, None]
        gain[:, chosen] = -np.inf
        top = np.argpartition(gain.ravel(), -SHORTLIST)[-SHORTLIST:]
        pairs = np.column_stack(np.unravel_index(top, gain.shape))
        trial = (
            information
            - np.einsum("ki,kj->kij", rows[chosen[pairs[:, 0]]], rows[chosen[pairs[:, 0]]])
            + np.einsum("ki,kj->kij", rows[pairs[:, 1]], rows[pairs[:, 1]])
        )
        least = np.linalg.eigvalsh(trial)[:, 0]
        best = int(np.argmax(least))
        if least[best] <= values[0] * (1.0 + GAIN):
            return chosen
        chosen[pairs[best, 0]] = pairs[best, 1]
