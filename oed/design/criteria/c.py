"""c: the variance of one combination of the parameters."""

import dataclasses

import numpy as np

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.protocol import Criterion
from oed.design.forms.variance import Variance

#: share of its size that a combination may lose in a basis that it belongs to: far above
#: rounding, and below what a reading could determine
OUTSIDE_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True, eq=False)
class CombinationVariance(Variance):
    """-c^T M^-1 c of one row c (1, n)."""

    name: str = "c"

    def restrict(self, basis: Array) -> Criterion:
        """The same row in the basis. Raises ValueError where it leaves the basis."""
        restricted = dataclasses.replace(self, factor=self.factor @ basis)
        whole_size = np.linalg.norm(self.factor)
        if np.linalg.norm(restricted.factor) < (1 - OUTSIDE_TOLERANCE) * whole_size:
            raise ValueError(
                "no reading determines the combination c: choose another, or give more candidates"
            )
        return restricted


criterion = NamedCriterion(
    name="c",
    about="-c' M^-1 c: variance of one combination",
    source="Pukelsheim (2006), Optimal Design of Experiments",
    meaning="variance of one combination of parameters, with a minus sign",
    form=lambda _, ingredient: CombinationVariance(
        np.atleast_2d(np.asarray(ingredient))
    ),
    needs="combination",
)
