"""The plan of stages in a result: `result.json`, section `plan`. See `result` for its
other sections.
"""

from __future__ import annotations

import msgspec

from oed.result.record import Record
from oed.result.recording import RecordingSection


class Sd(Record, frozen=True):
    """Standard deviation of a parameter, in its display unit."""

    sd: float
    unit: str


class StageRecord(Record, frozen=True):
    """One stage of the plan: measurement, what it identifies, its cost (min).

    The fields with defaults are those of planned stages. Accuracies are root mean
    squares over the workspace, by component and unit (`z_um`), after all stages up to
    this one.
    """

    measurement: str
    setups: list[str]  # in working order
    readings: int
    identifies: (
        int  # rank of its own readings, over the machine and the stage's set-ups
    )
    cost: float
    kappa: float
    predicted: dict[str, float]
    chosen: int | None = None  # candidates: readings, or whole runs
    begin_min: float | None = None
    end_min: float | None = None
    price: float = 0.0
    operator: str = ""
    available: dict[
        str, float
    ] = {}  # least and mean chance that a chosen candidate can be read
    lost: float | None = None  # candidates expected out of the instrument's travel
    cut_off_um: float | None = (
        None  # largest, of what linearisation leaves out of a reading after the stage
    )
    rank: int | None = None  # of all readings so far, over the machine's parameters
    parameters: dict[str, Sd] = {}  # after the stage
    #: parameters and combinations that no reading so far determines
    unidentified: list[str] = msgspec.field(default_factory=list, name="held")
    accuracy: dict[str, float] = {}
    realised: dict[str, float] = {}  # of virtual machines, over the predicted one
    realised_lost: float | None = None  # candidates that virtual machines lost
    coverage: float | None = None  # of their true parameters, inside 95 % intervals


class AlternativePlan(Record, frozen=True):
    """A plan in short: measurements in order, readings (or runs) of each, and why it is
    not the plan, in words.

    value is what plans are judged by, the smaller the better: the worst component over
    what is wanted, or the root mean square of the components over what they are before
    any reading.
    """

    names: list[str]
    readings: list[int]
    minutes: float
    value: float
    accuracy: dict[str, float]
    why: str = ""


class SequenceRecord(Record, frozen=True):
    """A sequence that was asked for, and the best plan found in its time. It takes all
    readings of each measurement, or, where they take longer than the budget, the best
    ones within it.

    gain: factor by which each component is more accurate with that plan;  bound: no plan of that time has a smaller
    value.  weakest: smallest singular value of its readings, in the scaling "length"
            (mm, angles times the lever)
    """

    name: str
    sequence: AlternativePlan = msgspec.field(name="way")
    rank: int
    parameters: int
    kappa: float
    weakest: float
    observability: dict[str, float]
    lost: float
    plan: AlternativePlan
    gain: dict[str, float]
    bound: float
    words: str = ""


class PlanEffects(Record, frozen=True):
    """The effects that a plan allows for, and the plan for a machine without them.

    without   that plan, with the accuracy that it reaches on a machine with the effects
    promised  accuracy that it has on a machine without them, by component and fine unit
    """

    groups: int
    unknowns: int  # combinations of them that the plan carries from stage to stage
    without: AlternativePlan
    promised: dict[str, float]
    words: str
    recording: RecordingSection | None = None  # what else to record


class PlanSection(Record, frozen=True):
    """The plan as stages. The fields with defaults are those of plans that were
    searched for.

    goal            wanted accuracy by component;  reached: whether the plan has it
    best_reachable  accuracy of the most accurate plan found
    needs           what would have to change, where that is not enough
    bound           no plan within the budget has a smaller value;  loss: share by which
                    the plan may miss it at most
    lines           supporting lines drawn for the bound
    front           plans of which none is both shorter and more accurate, shortest
                    first
    """

    stages: list[StageRecord]
    cost: float
    alternatives: list[str | AlternativePlan]
    budget_min: float | None = None
    price: float = 0.0
    value: float | None = None
    goal: dict[str, float] = {}
    reached: bool = True
    start_accuracy: dict[str, float] = {}
    accuracy: dict[str, float] = {}
    best_reachable: dict[str, float] = {}
    needs: list[str] = []
    bound: float | None = None
    loss: float | None = None
    lines: int | None = None
    front: list[AlternativePlan] = []
    stop: str = ""
    compared: list[SequenceRecord] = []
    after: str = ""  # what was known and done before, in words
    virtual_machines: int = 0
    effects: PlanEffects | None = None
