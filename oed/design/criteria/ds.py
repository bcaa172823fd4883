"""Ds: the volume of the confidence ellipsoid of the parameters of interest."""

from oed.design.catalogue import NamedCriterion
from oed.design.forms.determinant import Determinant

criterion = NamedCriterion(
    name="Ds",
    about="as D, of the parameters of interest; others are profiled out",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="log det over the parameters of interest alone",
    form=lambda columns, ingredient: Determinant(columns, ingredient, "Ds"),
    needs="interest",
    is_log_det=True,
)
