"""Checks the claims of a study on its result.

`of` is a dotted path into result.json: names of fields and keys (which may hold dots),
list entries by index from 0 (`plans[0]` or `plans.0`) or by their `name` or `title`
(`design.plans.exchange.kappa`).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

from oed.result import Claim
from oed.text import shorten, suggest
from pkm_studies.tables import ClaimTable, StudyFile

#: numbers of result.json that are in the `unit` which stands beside them
IN_UNIT = ("rms", "rms_raw", "p95", "max", "value", "sd", "mean", "q025", "q975")
#: most characters of a measured text
LONGEST = 200


def check_claims(
    study: StudyFile, result: Mapping[str, Any], only: tuple[str, ...] | None = None
) -> list[Claim]:
    """Each claim of [expect], in order, on a result as plain tables and lists.

    `only`: names of sections; claims about other sections are left out.
    """
    claims = []
    for name, table in study.expect.items():
        section = re.split(r"[.\[]", table.of)[0]
        if only is None or section in only:
            claims.append(check_claim(name, table, result))
    return claims


def claim_failure(claim: Claim, where: str) -> str:
    """What a claim that is not met says: measured against claimed, and where it stands."""
    measured = claim.measured
    if isinstance(measured, float):
        measured = f"{measured:.6g}"
    unit = f" {claim.unit}" if claim.unit else ""
    return f"{claim.claim}: measured {measured}{unit}, claimed {claim.wanted}{unit} ({where})"


def check_claim(name: str, table: ClaimTable, result: Mapping[str, Any]) -> Claim:
    """A claim on a result as plain tables and lists."""
    wanted = f"{table.of} {_wanted(table)}"
    try:
        value = value_at(result, table.of)
    except LookupError as error:
        measured = shorten(str(error), LONGEST)
        return Claim(claim=name, measured=measured, wanted=wanted, met=False)
    return Claim(
        claim=name,
        measured=_measured(value, table.contains),
        wanted=wanted,
        met=_is_met(table, value),
        unit=_unit(result, table.of, value),
    )


def _unit(result: Mapping[str, Any], path: str, value: object) -> str:
    """Unit that stands beside a number and belongs to it; empty where there is none."""
    table, _, name = path.rpartition(".")
    if not isinstance(value, float) or name not in IN_UNIT:
        return ""
    try:
        unit = _table(value_at(result, table)).get("unit", "")
    except LookupError:  # the name holds a dot
        return ""
    return unit if isinstance(unit, str) else ""


# -- the value at a path ---------------------------------------------------------------


def value_at(result: object, path: str) -> Any:
    """The value at a path.

    Raises LookupError that says how far the path leads, and what is there.
    """
    tokens = [t for t in re.split(r"\.|\[(\d+)\]", path) if t]
    walked: list[str] = []
    value = result
    while tokens:
        next_value, used = _step(value, tokens)
        if not used:
            raise LookupError(_dead_end(path, walked, tokens[0], value))
        walked += tokens[:used]
        value, tokens = next_value, tokens[used:]
    return value


def _dead_end(path: str, walked: list[str], token: str, value: object) -> str:
    where = ".".join(walked) or "the result"
    keys = [str(key) for key in _table(value)]
    there = suggest(token, keys, "there is") if keys else "nothing below it"
    return f"no such result: {path}: no {token} in {where}; {there}"


def _step(value: object, tokens: list[str]) -> tuple[object, int]:
    """The value below that the longest start of the path names; tokens used, or 0."""
    if isinstance(value, list) and tokens[0].isdigit() and int(tokens[0]) < len(value):
        return value[int(tokens[0])], 1
    table = _table(value)
    for used in range(len(tokens), 0, -1):
        key = ".".join(tokens[:used])
        if key in table:
            return table[key], used
    return None, 0


def _table(value: object) -> Mapping[str, object]:
    """What has a name below a value: keys of a table, list entries by name or title."""
    if isinstance(value, Mapping):
        return value
    if not isinstance(value, list):
        return {}
    table = {}
    for entry in reversed(value):  # of two entries with one name, the first counts
        if isinstance(entry, Mapping) and ("name" in entry or "title" in entry):
            table[str(entry.get("name", entry.get("title")))] = entry
    return table


# -- wanted and measured ---------------------------------------------------------------


def _wanted(table: ClaimTable) -> str:
    parts = []
    if table.equals is not None:
        parts.append(f"= {_format_value(table.equals)}")
    if table.min is not None:
        parts.append(f">= {table.min:g}")
    if table.max is not None:
        parts.append(f"<= {table.max:g}")
    if table.contains is not None:
        parts.append(f"contains {table.contains!r}")
    return " and ".join(parts)


def _format_value(value: bool | float | str) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _measured(value: object, wanted: str | None = None) -> float | str:
    """A number as it is; of everything else the sentence that is wanted, or the start."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    if wanted is not None:
        for sentence in _texts(value):
            if wanted in sentence:
                start = max(0, sentence.index(wanted) - LONGEST // 4)
                lead = "... " if start else ""
                return shorten(lead + sentence[start:], LONGEST)
    return shorten(value if isinstance(value, str) else json.dumps(value), LONGEST)


def _texts(value: object) -> Iterator[str]:
    """All texts in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for entry in value.values():
            yield from _texts(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from _texts(entry)


def _is_met(table: ClaimTable, value: object) -> bool:
    if table.equals is not None:
        same_kind = isinstance(value, bool) == isinstance(table.equals, bool)
        if not same_kind or value != table.equals:
            return False
    if table.contains is not None:
        text = value
        if not isinstance(text, str):
            text = json.dumps(text, ensure_ascii=False)
        if table.contains not in text:
            return False
    if table.min is None and table.max is None:
        return True
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    low = -math.inf if table.min is None else table.min
    high = math.inf if table.max is None else table.max
    return math.isfinite(value) and low <= value <= high
