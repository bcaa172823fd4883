"""O3: the least singular value."""

from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues

criterion = NamedCriterion(
    name="O3",
    about="least singular value",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="smallest singular value",
    form=lambda columns, ingredient: ExtremeEigenvalues(0.5, name="O3"),
    power=1,
    index=lambda s, readings: float(s.min()),
    index_of_each_plan=True,
    index_meaning=(
        "the observability index O3 of Nahvi, Hollerbach and Hayward (1994), the"
        " smallest singular value; larger is better"
    ),
)
