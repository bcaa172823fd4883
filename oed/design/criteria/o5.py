"""O5: the harmonic sum of the singular values."""

import dataclasses

import numpy as np

from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import PowerMean


@dataclasses.dataclass(frozen=True, eq=False)
class HarmonicSum(PowerMean):
    """1 / sum(1 / sigma_i) = sqrt(phi_1/2) / n."""

    p: float = 0.5
    name: str = "O5"

    def conventional_value(self, value: float, readings: int) -> float:
        """O5."""
        return float(np.exp(value / 2.0)) / self.directions


criterion = NamedCriterion(
    name="O5",
    about="harmonic sum of the singular values",
    source="Joubair and Bonev (2013), Mech. Mach. Theory 70",
    meaning="reciprocal of the sum of the reciprocal singular values",
    form=lambda columns, _: HarmonicSum(directions=columns),
    power=2,
    index=lambda s, readings: float(1.0 / np.sum(1.0 / s)),
    index_of_each_plan=True,
    index_meaning=(
        "the observability index O5 of Sun and Hollerbach (2008), the reciprocal of the"
        " sum of the reciprocal singular values; larger is better"
    ),
)
