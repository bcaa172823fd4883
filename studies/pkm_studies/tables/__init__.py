"""The tables of a study file as frozen structs, one or more a module.

A table is a struct of its own, with units in the names of its fields; unknown fields are
refused. Other rooms take them from here.
"""

from pkm_studies.tables.base import (
    TO_MEASURE,
    Count,
    NotNegative,
    Positive,
    StudyTable,
    Triple,
)
from pkm_studies.tables.design import DesignTable, LimitsTable, OrderTable, QuotaTable
from pkm_studies.tables.file import ClaimTable, StudyFile
from pkm_studies.tables.fit import (
    ForecastTable,
    PosteriorTable,
    PredictionReference,
    PredictionTable,
    ReadingsTable,
)
from pkm_studies.tables.gap import (
    ActingTable,
    ConditionsTable,
    GapDesignTable,
    GapTable,
    RunCondition,
)
from pkm_studies.tables.grids import (
    CIRCLE_PLANES,
    Axis,
    CircleTable,
    CubeTable,
    GridTable,
    KappaTable,
    Span,
)
from pkm_studies.tables.machine import (
    AdjustTable,
    BoundsTable,
    ControllerTable,
    DriveTable,
    MachineTable,
    SetupTable,
    ToleranceTable,
)
from pkm_studies.tables.plan import MeasuredTable, PlanTable
