"""The whole study file: its tables, report options and claims."""

from typing import Annotated, Literal

import msgspec

from pkm_studies.base import Name
from pkm_studies.tables.base import Count, Positive, StudyTable, Whole
from pkm_studies.tables.design import DesignTable
from pkm_studies.tables.fit import (
    ForecastTable,
    IdentifyTable,
    PosteriorTable,
    PredictionTable,
    ReadingsTable,
)
from pkm_studies.tables.gap import GapTable
from pkm_studies.tables.grids import KappaTable
from pkm_studies.tables.machine import (
    ControllerTable,
    MachineTable,
    NoiseTable,
    PriorTable,
    SetupTable,
)
from pkm_studies.tables.plan import PlanTable


class ReportTable(StudyTable, frozen=True, kw_only=True):
    """[report]: what the report holds.

    html    whether to write report.html
    pdf     whether to write report.pdf and the measurement sheet
    corner  number of directions in the corner plot of the posterior
    """

    html: bool = True
    pdf: bool = True
    corner: Count = 6


class ClaimTable(StudyTable, frozen=True, kw_only=True):
    """[expect]: a claim, which the result must meet.

    of        dotted path into result.json
    equals    the value
    min, max  bounds of the value
    contains  text that the value holds
    """

    of: str
    equals: bool | float | str | None = None
    min: float | None = None
    max: float | None = None
    contains: str | None = None


class StudyFile(StudyTable, frozen=True, kw_only=True):
    """A study file, schema 1.

    schema     version of this format: 1
    name       of the study and of its folder of results
    title      of the report
    question   that the study answers
    seed       of all random numbers
    slow       whether `pytest` runs its claims only with `-m slow`
    machine    [machine]: the model and its numbers
    setup      [[setup]] tables: instruments as mounted
    noise      [noise]: standard deviation of a reading
    prior      [prior]: tolerances of parameters
    design     [design]: readings to choose
    plan       [plan]: measurements to order
    kappa      [[kappa]] tables: maps of the condition number
    readings   [readings]: where readings come from
    identify   [identify]: how parameters are fitted
    posterior  [posterior]: how long to sample
    prediction [prediction]: accuracy over the workspace
    forecast   [forecast]: forecast compensation
    effects    [effects]: expected sizes of effects, the unit in the name:
               `leg_thermal_C = 1`
    gap        [gap]: effects that a diagnosis tries
    controller [controller]: the firmware that the machine has
    report     [report]: what the report holds
    expect     [expect]: claims that the result must meet
    """

    schema: Literal[1]
    name: Name
    title: str = ""
    question: str = ""
    seed: Whole = 0
    slow: bool = False
    machine: MachineTable
    setup: Annotated[list[SetupTable], msgspec.Meta(min_length=1)]
    noise: NoiseTable = NoiseTable()
    prior: PriorTable = PriorTable()
    design: DesignTable | None = None
    plan: PlanTable | None = None
    kappa: list[KappaTable] = []
    readings: ReadingsTable | None = None
    identify: IdentifyTable = IdentifyTable()
    posterior: PosteriorTable = PosteriorTable()
    prediction: PredictionTable | None = None
    forecast: ForecastTable | None = None
    effects: dict[str, Positive] = {}
    gap: GapTable | None = None
    controller: ControllerTable | None = None
    report: ReportTable = ReportTable()
    expect: dict[Name, ClaimTable] = {}
