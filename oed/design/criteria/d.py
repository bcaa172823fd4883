"""D: the volume of the confidence ellipsoid."""

from oed.design.catalogue import NamedCriterion
from oed.design.forms.determinant import Determinant

criterion = NamedCriterion(
    name="D",
    about="log det M: volume of the confidence ellipsoid",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="log det of the information: the volume of all uncertainty together",
    form=lambda columns, _: Determinant(columns),
    has_weights=True,
    label="log det",
    is_log_det=True,
)
