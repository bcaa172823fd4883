"""Studies that differ from a base in some fields, as campaigns and test sweeps vary it."""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from oed.text import suggest
from pkm_studies.base import Location
from pkm_studies.study import loader
from pkm_studies.study.loader import Study


def combinations(vary: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Every value of each field with every value of the others, in their order."""
    values = itertools.product(*vary.values())
    return [dict(zip(vary, combination, strict=True)) for combination in values]


def vary_setting(study: Study, setting: Mapping[str, Any], location: Location) -> Study:
    """The study with other values of some fields. Raises InputError.

    A field is addressed by its table and name; an entry of a list by its own name, as in
    `setup.cup.length_mm`.
    """
    tables = copy.deepcopy(tomllib.loads(study.text))
    for field, value in setting.items():
        _assign(tables, field, value, location.key(field))
    text = msgspec.toml.encode(tables).decode()
    return loader.parse(text, study.path, study.consent)


def _assign(tables: Any, field: str, value: Any, location: Location) -> None:
    """Set a field of nested tables, addressed by keys and names of list entries."""
    *way, last = field.split(".")
    entry = tables
    for key in way:
        entry = _entry(entry, key, location)
    if not isinstance(entry, dict):
        raise location.error("this is no field of a table", "name a field of the study")
    entry[last] = value


def _entry(at: Any, key: str, location: Location) -> Any:
    """What a table or a list of named tables holds under a key."""
    if isinstance(at, list):
        named = {str(entry.get("name")): entry for entry in at}
        if key not in named:
            raise location.error(f"no entry {key!r}", suggest(key, named))
        return named[key]
    if isinstance(at, dict):
        return at.setdefault(key, {})
    raise location.error(f"{key!r} lies in no table", "name a field of the study")
