"""The whole study file: its tables, report options and claims."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.study.tables.base import (
    Count,
    Name,
    StudyTable,
    Whole,
)
from pkm_studies.study.tables.design import DesignTable
from pkm_studies.study.tables.fit import (
    IdentifyTable,
    PosteriorTable,
    PredictionTable,
    ReadingsTable,
)
from pkm_studies.study.tables.gap import GapTable
from pkm_studies.study.tables.grids import KappaTable
from pkm_studies.study.tables.machine import (
    MachineTable,
    NoiseTable,
    PriorTable,
    SetupTable,
)
from pkm_studies.study.tables.plan import PlanTable


class ReportTable(StudyTable, frozen=True, kw_only=True):
    """[report]."""

    html: bool = True
    pdf: bool = True
    corner: Count = 6


class ClaimTable(StudyTable, frozen=True, kw_only=True):
    """[expect]: what a result must be. `of` is a dotted path into result.json."""

    of: str
    equals: bool | float | str | None = None
    min: float | None = None
    max: float | None = None
    contains: str | None = None


class StudyFile(StudyTable, frozen=True, kw_only=True):
    """A study file, schema 1."""

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
    gap: GapTable | None = None
    report: ReportTable = ReportTable()
    expect: dict[Name, ClaimTable] = {}
