"""What the readings of a plan can see: the `identifiability` sections of result.json."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import msgspec

from oed.result.record import Number, Record, Size


class IdentifiabilityFinding(Record, frozen=True):
    """One line of the identifiability verdict in words."""

    kind: str  # seen | combination | lost | weak
    text: str
    remedies: tuple[str, ...] = ()  # additional readings that would help, a phrase each


class IdentifiabilitySection(Record, frozen=True):
    """What the plan's readings can see. Combinations and lost directions are
    {parameter: coefficient}, SI.
    """

    parameters: list[str]
    n: int
    rank: Annotated[int, msgspec.Meta(ge=0)]
    tolerance: float  # singular values below this share of the largest count as zero
    scaling: str
    singular_values: list[Size]
    combinations: list[dict[str, float]]
    lost: list[dict[str, float]]
    words: list[IdentifiabilityFinding]
    #: {index: value} over the determined directions, where the study asks for them
    indices: dict[str, float] = {}


class KappaMap(Record, frozen=True):
    """Condition number over the number of circles and of points on each, for one
    parametrisation.
    """

    title: str
    circles: list[int]
    points: list[int]
    kappa: Sequence[Sequence[Number]]  # [circle][point]
