"""Tables of [gap]: effects that a diagnosis tries, and those of a virtual machine."""

from typing import Annotated, Literal

import msgspec

from pkm_studies.tables.base import NotNegative, Positive, RunCount, StudyTable

# Tables of [gap.design]: runs that separate effects, and their conditions.


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


# Tables of [gap]: effects that a diagnosis tries, and those of a virtual machine.


class WarmingTable(StudyTable, frozen=True, kw_only=True):
    """A body that warms exponentially.

    rise_C     final temperature above that at time 0
    after_min  time constant
    """

    rise: float = msgspec.field(name="rise_C")
    after_min: Positive


class ConditionsTable(StudyTable, frozen=True, kw_only=True):
    """[gap.conditions]: how a virtual machine is read.

    start_min    when reading begins; machine, screws and bar warm up from time 0
    reading_s    time of one reading; by default the instrument's
    setup_min    time to mount a set-up; by default the instrument's
    pause_s      between two runs
    feed_mm_min  one value, or several that the runs take in turn
    payload_N    likewise; each pass of a run counts as a run
    temperature  recorded temperatures by body, as in
                 `{ leg = { rise_C = 2, after_min = 60 } }`

    Repeats and directions are those of each [[setup]].
    """

    start_min: NotNegative = 0.0
    reading_s: Positive | None = None
    setup_min: NotNegative | None = None
    pause_s: NotNegative = 0.0
    feed_mm_min: (
        Positive | Annotated[list[Positive], msgspec.Meta(min_length=1)] | None
    ) = None
    payload: (
        NotNegative | Annotated[list[NotNegative], msgspec.Meta(min_length=1)] | None
    ) = msgspec.field(default=None, name="payload_N")
    temperature: dict[str, WarmingTable] = {}


class ActingTable(StudyTable, frozen=True, kw_only=True):
    """[[gap.acting]]: an effect that the virtual machine has.

    effect        a name of `oed list effects`, or a file of your own
    size          factor of its coefficients, in their prior standard deviations
    draw          whether the coefficients are drawn with that spread
    coefficients  by name (`"leg 1" = 2`), times `size`; those not named are 0. By
                  default every coefficient of the textbook's form is 1
    constants     its nonlinear constants, SI; by default, of the values that the
                  diagnosis tries, the middle one of the first constant and the first of
                  the others
    """

    effect: str
    size: float = 1.0
    draw: bool = False
    coefficients: dict[str, float] = {}
    constants: dict[str, float] = {}


class GapTable(StudyTable, frozen=True, kw_only=True):
    """[gap]: which unmodelled effects the diagnosis tries.

    effects     names of `oed list effects` or files of your own (`my.py:effect`); "all"
                for all known ones, the default
    without     names to leave out
    gravity     its direction in the base frame, any length
    conditions  [gap.conditions]: how a virtual machine is read
    acting      [[gap.acting]] tables: effects that the virtual machine has
    design      [gap.design]: runs that separate effects
    """

    effects: list[str] = msgspec.field(default_factory=lambda: ["all"])
    without: list[str] = []
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)
    conditions: ConditionsTable = ConditionsTable()
    acting: list[ActingTable] = []
    design: GapDesignTable | None = None
