"""Criteria as information functions, with the slopes and lines that bound plans.

    determinant  D, Ds, O1
    variance     A, c, I, G
    power        phi_p, O5
    spectrum     E, kappa, O2, O3, O4
    compound     weighted geometric means of the others

`named` finds a criterion by its name in the catalogue (`oed.design.criteria.CATALOGUE`).
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.design.criterion.compound import Compound
from oed.design.criterion.determinant import Determinant
from oed.design.criterion.power import PowerMean
from oed.design.criterion.protocol import Criterion, Support
from oed.design.criterion.spectrum import ExtremeEigenvalues
from oed.design.criterion.variance import LargestVariance, Variance

__all__ = [
    "Compound",
    "Criterion",
    "Determinant",
    "ExtremeEigenvalues",
    "LargestVariance",
    "PowerMean",
    "Support",
    "Variance",
    "named",
]
NAMES = ("D", "Ds", "A", "c", "I", "G", "E", "kappa", "O1", "O2", "O3", "O4", "O5")
#: what a criterion needs besides its name
NEEDS = {
    "Ds": "directions of interest",
    "c": "a combination",
    "I": "a workspace",
    "G": "a workspace",
}


def named(
    name: str,
    directions: int,
    *,
    interest: Array | None = None,
    factor: Array | None = None,
    factors: Array | None = None,
) -> Criterion:
    """A criterion over `directions` columns.

    interest  (n, s) for Ds
    factor    (r, n) for I, one row for c
    factors   (J, r, n) for G

    Raises ValueError for an unknown name, or where one of these is missing.
    """
    if name == "Ds" and interest is not None:
        return Determinant(directions, interest, "Ds")
    if name in ("I", "c") and factor is not None:
        return Variance(np.atleast_2d(factor), name)
    if name == "G" and factors is not None:
        return LargestVariance(factors)
    if name in NEEDS:
        raise ValueError(f"criterion {name} needs {NEEDS[name]}")
    table: dict[str, Criterion] = {
        "D": Determinant(directions),
        "O1": Determinant(directions, name="O1"),
        "A": Variance(np.eye(directions), "A"),
        "E": ExtremeEigenvalues(),
        "O3": ExtremeEigenvalues(0.5, name="O3"),
        "O2": ExtremeEigenvalues(0.5, 0.5, name="O2"),
        "kappa": ExtremeEigenvalues(0.5, 0.5, name="kappa"),
        "O4": ExtremeEigenvalues(1.0, 0.5, name="O4"),
        "O5": PowerMean(0.5, directions, "O5"),
    }
    if name not in table:
        raise ValueError(f"criterion {name!r} is none of {', '.join(NAMES)}")
    return table[name]
