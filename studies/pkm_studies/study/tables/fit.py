"""Tables for readings, identification, posterior and prediction."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from pkm_studies.study.tables.base import (
    Count,
    StudyTable,
    Whole,
)
from pkm_studies.study.tables.grids import Axis


class ReadingsTable(StudyTable, frozen=True, kw_only=True):
    """[readings]: from files, from a named source of data, or from a virtual machine."""

    files: list[str] = []
    source: str | None = None
    path: str | None = None
    simulate: bool = False
    draw: bool = False
    truth: dict[str, float | dict[str, float]] = {}
    fit: list[str] | None = None
    predict: list[str] = []


class IdentifyTable(StudyTable, frozen=True, kw_only=True):
    """[identify]: parameters freed in turn, by name or pattern."""

    stages: Annotated[list[list[str]], msgspec.Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: [["*"]]
    )
    max_iterations: Count = 50


class PosteriorTable(StudyTable, frozen=True, kw_only=True):
    """[posterior]: how long to sample. `steps` is the most; sampling stops at `ess` a
    parameter.
    """

    enabled: bool = True
    walkers: Annotated[int, msgspec.Meta(ge=4, le=100_000)] | None = None
    steps: Count = 20_000
    ess: Count = 1000
    thin: Count | None = None


class PredictionTable(StudyTable, frozen=True, kw_only=True):
    """[prediction]: residual accuracy over a grid of the workspace, against a
    reference.
    """

    rest = "coordinates"
    reference: Literal["home", "absolute", "best_fit"] = "home"
    virtual_machines: Whole = 0
    coordinates: dict[str, Axis] = {}
