"""O3: the least singular value."""

from __future__ import annotations

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues


def over(columns: int, ingredient: Array | None) -> ExtremeEigenvalues:
    """Root of the least eigenvalue of M."""
    return ExtremeEigenvalues(0.5, name="O3")


def of_singular_values(singular_values: Array, readings: int) -> float:
    """sigma_min."""
    return float(singular_values.min())


criterion = NamedCriterion(
    name="O3",
    about="least singular value",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="smallest singular value",
    form=over,
    power=1,
    index=of_singular_values,
    index_of_each_plan=True,
    index_meaning=(
        "the observability index O3 of Nahvi, Hollerbach and Hayward (1994), the"
        " smallest singular value; larger is better"
    ),
)
