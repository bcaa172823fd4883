"""O2: the reciprocal condition number."""

from __future__ import annotations

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues


def over(columns: int, ingredient: Array | None) -> ExtremeEigenvalues:
    """1 / kappa(H)."""
    return ExtremeEigenvalues(0.5, 0.5, name="O2")


def of_singular_values(singular_values: Array, readings: int) -> float:
    """sigma_min / sigma_max."""
    return float(singular_values.min() / singular_values.max())


criterion = NamedCriterion(
    name="O2",
    about="reciprocal condition number",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="reciprocal condition number",
    form=over,
    power=1,
    index=of_singular_values,
    index_of_each_plan=True,
    index_meaning=(
        "the observability index O2 of Driels and Pathre (1990), the reciprocal"
        " condition number; larger is better"
    ),
)
