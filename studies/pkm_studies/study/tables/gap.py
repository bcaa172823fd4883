"""[gap]: the unmodelled effects that a diagnosis tries, and those that a virtual
machine has.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from pkm_studies.study.tables.base import NotNegative, Positive, StudyTable
from pkm_studies.study.tables.gap_design import GapDesignTable


class WarmingTable(StudyTable, frozen=True, kw_only=True):
    """A body that warms by `rise_C` above its state at time 0, with time constant
    `after_min`.
    """

    rise: float = msgspec.field(name="rise_C")
    after_min: Positive


class ConditionsTable(StudyTable, frozen=True, kw_only=True):
    """[gap.conditions]: how a virtual machine is read. Repeats and directions are those
    of each [[setup]].

    start_min              when reading begins; machine, screws and bar warm up from
                           time 0
    reading_s, setup_min   time of one reading, and to mount a set-up; by default the
                           instrument's
    pause_s                between two runs
    feed_mm_min, payload_N one value, or several that the runs (each pass by itself)
    take in turn
    temperature            recorded temperatures by body: `{ leg = { rise_C = 2,
                           after_min = 60 } }`
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

    size          of its coefficients, in their prior standard deviations; drawn with
                  that spread where `draw` is true
    coefficients  by name (`"leg 1" = 2`), in prior standard deviations times `size`;
                  those not named are 0. By default every coefficient of the textbook's
                  form is 1
    constants     its nonlinear constants, SI; by default, of the values that the
                  diagnosis tries, the middle one of the first constant and the first
                  one of others
    """

    effect: str
    size: float = 1.0
    draw: bool = False
    coefficients: dict[str, float] = {}
    constants: dict[str, float] = {}


class GapTable(StudyTable, frozen=True, kw_only=True):
    """[gap]: which effects the diagnosis of readings tries.

    effects  names of `oed list effects` or files of your own (`my.py:effect`); "all"
             for all known ones, the default
    without  names left out
    gravity  its direction in the base frame, any length
    """

    effects: list[str] = msgspec.field(default_factory=lambda: ["all"])
    without: list[str] = []
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)
    conditions: ConditionsTable = ConditionsTable()
    acting: list[ActingTable] = []
    design: GapDesignTable | None = None
