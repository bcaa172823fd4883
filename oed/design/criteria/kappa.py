"""kappa: the condition number of H."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues


@dataclasses.dataclass(frozen=True, eq=False)
class ConditionNumber(ExtremeEigenvalues):
    """sigma_max / sigma_min = 1 / phi."""

    least: float = 0.5
    largest: float = 0.5
    name: str = "kappa"

    def conventional_value(self, value: float, readings: int) -> float:
        """kappa."""
        return float(np.exp(-value))


def over(columns: int, ingredient: Array | None) -> ConditionNumber:
    """Condition number of H."""
    return ConditionNumber()


def of_singular_values(singular_values: Array, readings: int) -> float:
    """sigma_max / sigma_min."""
    return float(singular_values.max() / singular_values.min())


criterion = NamedCriterion(
    name="kappa",
    about="condition number of H",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="condition number of the scaled identification matrix",
    form=over,
    smaller_is_better=True,
    index=of_singular_values,
    index_meaning=(
        "the condition number κ(H) of the identification matrix (Tian et al. 2016, Fig."
        " 6; O2 of Sun and Hollerbach 2008 is its reciprocal); smaller is better"
    ),
    symbol="κ",
)
