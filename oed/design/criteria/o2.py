"""O2: the reciprocal condition number."""

from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues

criterion = NamedCriterion(
    name="O2",
    about="reciprocal condition number",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="reciprocal condition number",
    form=lambda columns, ingredient: ExtremeEigenvalues(0.5, 0.5, name="O2"),
    power=1,
    index=lambda s, readings: float(s.min() / s.max()),
    index_of_each_plan=True,
    index_meaning=(
        "the observability index O2 of Driels and Pathre (1990), the reciprocal"
        " condition number; larger is better"
    ),
)
