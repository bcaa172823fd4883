"""JSON schemas of the three files that people and scripts write or read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from oed import units
from oed.result import StudyResult
from pkm_studies.study.tables import StudyFile, StudyTable

DIALECT = "https://json-schema.org/draft/2020-12/schema"
Document = dict[str, Any]


def study() -> Document:
    """Schema of `*.study.toml`."""
    made = _of(StudyFile, "A planning study")
    for part in _parts(StudyTable):
        if part.rest is not None and part.__name__ in made["$defs"]:
            _open(made["$defs"][part.__name__], part)
    return made


def result() -> Document:
    """Schema of `result.json`."""
    return _of(StudyResult, "The result of a study")


def readings() -> Document:
    """Schema of one row of `*.readings.csv`, cells as numbers and text, nothing for an
    empty cell.
    """
    unit = "|".join(units.UNITS)
    number = {"type": ["number", "null"]}
    return {
        "$schema": DIALECT,
        "title": "One row of a readings file",
        "description": (
            "CSV, UTF-8, commas, a header. The unit ends the column's name. An empty"
            " cell is a reading not taken; the first row of a relative or calliper run"
            " is its reference. Pose columns are the machine's command coordinates"
            " (z_mm, psi_deg) or its joints (q1_mm), channels those of the set-up's"
            " instrument (length_mm): see `oed list`."
        ),
        "type": "object",
        "required": ["setup", "run", "order"],
        "properties": {
            "setup": {
                "type": "string",
                "minLength": 1,
                "description": "names a [[setup]] of the study",
            },
            "run": {"type": ["string", "number"], "description": "a circle, a line"},
            "order": {"type": "integer", "description": "in time within the run"},
            "direction": {"enum": [1, -1, None]},
            "feed_mm_min": number,
            "repeat": number,
        },
        "patternProperties": {f"^[A-Za-z][A-Za-z0-9_]*_({unit})$": number},
        "additionalProperties": False,
    }


SCHEMAS: dict[str, Callable[[], Document]] = {
    "study": study,
    "result": result,
    "readings": readings,
}


def _of(kind: type, title: str) -> Document:
    made = msgspec.json.schema(kind)
    return {"$schema": DIALECT, "title": title, **made}


def _parts(base: type[StudyTable]) -> Iterator[type[StudyTable]]:
    for part in base.__subclasses__():
        yield part
        yield from _parts(part)


def _open(schema: Document, part: type[StudyTable]) -> None:
    """Fields of free name stand in the table itself, not in a table named as the
    struct's field.
    """
    collected = schema["properties"].pop(part.rest)
    schema["additionalProperties"] = collected["additionalProperties"]
