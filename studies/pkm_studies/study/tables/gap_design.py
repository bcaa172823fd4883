"""[gap.design]: which runs to take, under which conditions, so that effects can be told
apart.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.study.tables.base import NotNegative, Positive, RunCount, StudyTable

#: `keep` with this name is the plan that [plan] makes
PLAN = "plan"


class RunCondition(StudyTable, frozen=True, kw_only=True):
    """How a run can be taken; what is not given is not known, and effects that need it
    cannot be looked for.

    direction     +1: poses in the order of the plan, -1: in reverse
    start_min     when the run begins, min: with it no two chosen runs may overlap in
                  time
    """

    direction: Literal[1, -1] = 1
    feed_mm_min: Positive | None = None
    payload: NotNegative | None = msgspec.field(default=None, name="payload_N")
    start_min: NotNegative | None = None


class GapDesignTable(StudyTable, frozen=True, kw_only=True):
    """[gap.design]: runs chosen so that the wanted effects can be told from one
    another.

    find        effects wanted, by name or file; each is told from every other one and
                from the `rivals`
    candidates  names of [[design.reference]] plans whose runs (circles, lines) can be
                taken; by default of all
    keep        name of a plan whose runs are taken in any case, under the first
                condition: one made for accuracy, to which runs are added that find the
                cause of what it leaves. Number and budget are of the added runs.
                "plan": what [plan] chooses; `budget_min` is then taken from the time
                that [plan] has, and without it and `runs` there is what the plan leaves
                of its time
    conditions  each run can be taken under each of them
    runs        how many to choose;  budget_min: time there is, mounting included; one
                of the two, or both
    share       share of D in what is maximised: 0 only tells effects apart, 1 only sees
                the parameters
    starts      rounds of the search
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
