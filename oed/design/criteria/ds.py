"""Ds: the volume of the confidence ellipsoid of the parameters of interest."""

from __future__ import annotations

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.determinant import Determinant


def over(columns: int, ingredient: Array | None) -> Determinant:
    """-log det(K^T M^-1 K) of the directions K (n, s)."""
    return Determinant(columns, ingredient, "Ds")


criterion = NamedCriterion(
    name="Ds",
    about="as D, of the parameters of interest; others are profiled out",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="log det over the parameters of interest alone",
    form=over,
    needs="interest",
    is_log_det=True,
)
