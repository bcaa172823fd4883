"""The base of a study's tables, and the kinds of numbers in them."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

import msgspec

from oed.design import CRITERIA

Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
RunCount = Annotated[int, msgspec.Meta(ge=1, le=100_000)]
Whole = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Triple = tuple[float, float, float]
Pair = tuple[float, float]
#: a number, a list of numbers, or a list of points
Numbers = float | list[float | list[float]]
if TYPE_CHECKING:
    CriterionName = str
    IndexName = str
else:  # as the catalogue lists them
    CriterionName = Literal[CRITERIA.plan_names]
    IndexName = Literal[CRITERIA.indices]
#: what a draft has in place of a number that nobody but its user knows
TO_MEASURE: Final = "to be measured"
#: readings chosen where neither a number nor a budget is given
DEFAULT_READINGS = 30


class StudyTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all tables: frozen, unknown fields refused.

    `free_keys` names the field that collects keys of free name.
    """

    free_keys: ClassVar[str | None] = None
