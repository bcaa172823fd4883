"""Tables of [gap.design]: runs that separate effects, and their conditions."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.tables.base import NotNegative, Positive, RunCount, StudyTable

#: `keep` with this name is the plan that [plan] makes
PLAN = "plan"


class RunCondition(StudyTable, frozen=True, kw_only=True):
    """A condition under which a run can be taken.

    direction    +1: poses in the order of the plan; -1: in reverse
    feed_mm_min  feed of the run
    payload_N    load of the run
    start_min    when the run begins: with it, no two chosen runs may overlap in time

    What is not given is unknown, and effects that need it cannot be looked for.
    """

    direction: Literal[1, -1] = 1
    feed_mm_min: Positive | None = None
    payload: NotNegative | None = msgspec.field(default=None, name="payload_N")
    start_min: NotNegative | None = None


class GapDesignTable(StudyTable, frozen=True, kw_only=True):
    """[gap.design]: which runs to take, under which conditions, to separate effects.

    find        effects to separate from each other and from the `rivals`
    rivals      further effects
    candidates  names of [[design.reference]] plans whose runs (circles, lines) can be
                taken; by default all
    keep        name of a plan whose runs are taken in any case, under the first
                condition; runs that find the cause are added to it. "plan": what [plan]
                chooses. `budget_min` is then taken from the time of [plan]; without it
                and `runs`, it is the time that [plan] does not use
    conditions  each run can be taken under each of them
    runs        number of runs to choose, retained ones not counted
    budget_min  time there is for them, mounting included; instead of `runs` or with it
    share       share of D in what is maximised: 0 only separates effects, 1 only
                determines the parameters
    starts      number of search rounds
    """

    find: Annotated[list[str], msgspec.Meta(min_length=1)]
    rivals: list[str] = []
    candidates: list[str] = []
    keep: str | None = None
    conditions: Annotated[list[RunCondition], msgspec.Meta(min_length=1)] = (
        msgspec.field(default_factory=lambda: [RunCondition()])
    )
    runs: RunCount | None = None
    budget_min: Positive | None = None
    share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.1
    starts: RunCount = 12
