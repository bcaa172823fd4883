"""JSON schemas of the files that people and scripts write or read."""

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from oed import units
from oed.result import StudyResult
from pkm_studies.tables import StudyFile, StudyTable

DIALECT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]
#: the first line of a field in a docstring: its name, or several, and what it is
FIELD = re.compile(r"^(\w+(?:, \w+)*) +(\S.*)$")


def study() -> Schema:
    """Schema of `*.study.toml`."""
    schema = _schema(StudyFile, "A planning study")
    definitions = schema["$defs"]
    for table in _subclasses(StudyTable):
        names = [
            kind.__name__ for kind in table.__mro__ if kind.__name__ in definitions
        ]
        for name in names[1:]:
            for field, inherited in definitions[name]["properties"].items():
                described = definitions[names[0]]["properties"][field]
                described.setdefault("description", inherited["description"])
        if table.free_keys is not None and table.__name__ in definitions:
            _open(definitions[table.__name__], table.free_keys)
    return schema


def result() -> Schema:
    """Schema of `result.json`."""
    return _schema(StudyResult, "The result of a study")


def readings() -> Schema:
    """Schema of one row of `*.readings.csv`; an empty cell is null."""
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


SCHEMAS: dict[str, Callable[[], Schema]] = {
    "study": study,
    "result": result,
    "readings": readings,
}


def _schema(kind: type, title: str) -> Schema:
    schema = {"$schema": DIALECT, "title": title, **msgspec.json.schema(kind)}
    for definition in schema["$defs"].values():
        properties = definition.get("properties", {})
        meanings = _meanings(definition.get("description", ""), set(properties))
        for name, meaning in meanings.items():
            properties[name]["description"] = meaning
    return schema


def _meanings(docstring: str, names: set[str]) -> dict[str, str]:
    """Meaning of each field that a docstring lists, by its name."""
    meanings: dict[str, str] = {}
    fields: list[str] = []
    for line in inspect.cleandoc(docstring).splitlines():
        match = FIELD.match(line)
        if match and names.issuperset(match[1].split(", ")):
            fields = match[1].split(", ")
            meanings |= dict.fromkeys(fields, match[2])
        elif line.startswith(" "):
            meanings |= {name: f"{meanings[name]} {line.strip()}" for name in fields}
        else:
            fields = []
    return meanings


def _subclasses(base: type[StudyTable]) -> Iterator[type[StudyTable]]:
    for table in base.__subclasses__():
        yield table
        yield from _subclasses(table)


def _open(schema: Schema, free_keys: str) -> None:
    """Allow keys of free name in the table, in place of the field that collects them."""
    field = schema["properties"].pop(free_keys)
    schema["additionalProperties"] = field["additionalProperties"]
