"""kappa: the condition number of H."""

import dataclasses

import numpy as np

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


criterion = NamedCriterion(
    name="kappa",
    about="condition number of H",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="condition number of the scaled identification matrix",
    form=lambda columns, ingredient: ConditionNumber(),
    smaller_is_better=True,
    index=lambda s, readings: float(s.max() / s.min()),
    index_meaning=(
        "the condition number κ(H) of the identification matrix (Tian et al. 2016, Fig."
        " 6; O2 of Sun and Hollerbach 2008 is its reciprocal); smaller is better"
    ),
    symbol="κ",
)
