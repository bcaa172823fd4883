"""O4: the least singular value squared over the largest."""

from __future__ import annotations

import dataclasses

from oed.base import Array
from oed.design.catalogue import NamedCriterion
from oed.design.forms.eigenvalues import ExtremeEigenvalues
from oed.design.relaxation import Relaxation


@dataclasses.dataclass(frozen=True, eq=False)
class SquareOverLargest(ExtremeEigenvalues):
    """sigma_min^2 / sigma_max."""

    least: float = 1.0
    largest: float = 0.5
    name: str = "O4"

    def eigenvalue_relaxation(
        self, blocks: Array, size: float, prior: Array, cap: Array | float
    ) -> Relaxation:
        """Under the envelope of lines that bound the least eigenvalue."""
        from oed.design import condition  # it takes forms of criteria

        return condition.o4(blocks, size, prior, cap).log_phi_relaxation(1.0)


criterion = NamedCriterion(
    name="O4",
    about="least singular value squared over the largest",
    source="Sun and Hollerbach (2008), Observability index selection, ICRA",
    meaning="smallest singular value squared over the largest",
    form=lambda columns, ingredient: SquareOverLargest(),
    power=1,
    index=lambda s, readings: float(s.min() ** 2 / s.max()),
    index_of_each_plan=True,
    index_meaning=(
        "the noise amplification index O4 of Nahvi and Hollerbach (1996), the smallest"
        " singular value squared over the largest; larger is better"
    ),
)
