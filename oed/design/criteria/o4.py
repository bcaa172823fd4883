"""O4: the least singular value squared over the largest."""

from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues

criterion = NamedCriterion(
    name="O4",
    about="least singular value squared over the largest",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="smallest singular value squared over the largest",
    form=lambda columns, ingredient: ExtremeEigenvalues(1.0, 0.5, name="O4"),
    power=1,
    index=lambda s, readings: float(s.min() ** 2 / s.max()),
    index_of_each_plan=True,
    index_meaning=(
        "the noise amplification index O4 of Nahvi and Hollerbach (1996), the smallest"
        " singular value squared over the largest; larger is better"
    ),
)
