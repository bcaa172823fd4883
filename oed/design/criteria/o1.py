"""O1: the geometric mean of the singular values."""

import dataclasses

import numpy as np

from oed.design.catalogue import NamedCriterion
from oed.design.forms.determinant import Determinant


@dataclasses.dataclass(frozen=True, eq=False)
class GeometricMean(Determinant):
    """D as (sigma_1 ... sigma_L)^(1/L) / sqrt(m), m the number of readings."""

    name: str = "O1"

    def conventional_value(self, value: float, readings: int) -> float:
        """O1."""
        log_det = super().conventional_value(value, readings)
        return float(np.exp(log_det / self.size / 2.0) / np.sqrt(readings))


criterion = NamedCriterion(
    name="O1",
    about="geometric mean of the singular values over sqrt(m)",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning=(
        "geometric mean of the singular values over the root of the number of readings"
    ),
    form=lambda columns, _: GeometricMean(columns),
    power=2,
    index=lambda s, readings: float(np.exp(np.log(s).mean()) / np.sqrt(readings)),
    index_of_each_plan=True,
    index_meaning=(
        "the observability index O1 of Borm and Menq (1991), the geometric mean of the"
        " singular values over the root of the number of readings; larger is better"
    ),
)
