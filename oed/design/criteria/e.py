"""E: the worst-determined direction."""

from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues

criterion = NamedCriterion(
    name="E",
    about="least eigenvalue of M: the worst-known direction",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="smallest eigenvalue of the information: the worst-determined direction",
    form=lambda columns, ingredient: ExtremeEigenvalues(),
    has_weights=True,
    power=1,
)
