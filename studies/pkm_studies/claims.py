"""Claims of a study, measured on its result.

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
from pkm_studies.errors import shorten, suggest
from pkm_studies.study.tables import ClaimTable, StudyFile

LONGEST = 200


def check_claims(
    study: StudyFile, result: Mapping[str, Any], only: tuple[str, ...] | None = None
) -> list[Claim]:
    """Each claim of [expect], in order. `result` is the result as plain tables and
    lists.

    `only`: the sections that were made; claims about others are left out.
    """
    asked = {
        n: t
        for n, t in study.expect.items()
        if only is None or re.split(r"[.\[]", t.of)[0] in only
    }
    return [_check(name, table, result) for name, table in asked.items()]


def lookup(result: object, path: str) -> Any:
    """The value at a path. Raises LookupError that says how far the path led and what
    there is.
    """
    tokens = [t for t in re.split(r"\.|\[(\d+)\]", path) if t]
    seen: list[str] = []
    value = result
    while tokens:
        step, used = _step(value, tokens)
        if not used:
            there = _keys(value)
            told = (
                suggest(tokens[0], there, "there is") if there else "nothing below it"
            )
            raise LookupError(
                f"no such result: {path}: no {tokens[0]} in"
                f" {'.'.join(seen) or 'the result'}; {told}"
            )
        seen += tokens[:used]
        value, tokens = step, tokens[used:]
    return value


def _step(value: object, tokens: list[str]) -> tuple[object, int]:
    """The value that the longest matching start of the path leads to, and how many
    tokens that is (0: none).
    """
    if isinstance(value, list) and tokens[0].isdigit() and int(tokens[0]) < len(value):
        return value[int(tokens[0])], 1
    table = _table(value)
    for used in range(len(tokens), 0, -1):
        key = ".".join(tokens[:used])
        if key in table:
            return table[key], used
    return None, 0


def _table(value: object) -> Mapping[str, object]:
    """What can be named below a value: keys of a table, entries of a list by name or
    title.
    """
    if isinstance(value, Mapping):
        return value
    if isinstance(value, list):
        named = [v for v in value if isinstance(v, Mapping)]
        return {
            str(v.get("name", v.get("title"))): v
            for v in reversed(named)
            if "name" in v or "title" in v
        }
    return {}


def _keys(value: object) -> list[str]:
    return [str(k) for k in _table(value)]


def _check(name: str, table: ClaimTable, result: Mapping[str, Any]) -> Claim:
    wanted = f"{table.of} {_wanted(table)}"
    try:
        measured = lookup(result, table.of)
    except LookupError as error:
        return Claim(
            claim=name, measured=shorten(str(error), LONGEST), wanted=wanted, met=False
        )
    return Claim(
        claim=name,
        measured=_told(measured, table.contains),
        wanted=wanted,
        met=_met(table, measured),
    )


def _wanted(table: ClaimTable) -> str:
    parts = []
    if table.equals is not None:
        parts.append(f"= {_value(table.equals)}")
    if table.min is not None:
        parts.append(f">= {table.min:g}")
    if table.max is not None:
        parts.append(f"<= {table.max:g}")
    if table.contains is not None:
        parts.append(f"contains {table.contains!r}")
    return " and ".join(parts)


def _value(value: object) -> str:
    return (
        f"{value:g}"
        if isinstance(value, float)
        else str(value).lower()
        if isinstance(value, bool)
        else str(value)
    )


def _told(measured: object, wanted: str | None = None) -> float | str:
    """A number as it is, everything else as text: the sentence that holds what was
    wanted, or the beginning.
    """
    if isinstance(measured, int | float) and not isinstance(measured, bool):
        return measured
    sentences = list(_sentences(measured))
    found = next((s for s in sentences if wanted is not None and wanted in s), None)
    if found is None:
        return shorten(
            measured if isinstance(measured, str) else json.dumps(measured), LONGEST
        )
    start = max(0, found.index(wanted or "") - LONGEST // 4)
    return shorten(("... " if start else "") + found[start:], LONGEST)


def _sentences(value: object) -> Iterator[str]:
    """All texts in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from _sentences(part)
    elif isinstance(value, list):
        for part in value:
            yield from _sentences(part)


def _met(table: ClaimTable, measured: object) -> bool:
    number = (
        isinstance(measured, int | float)
        and not isinstance(measured, bool)
        and math.isfinite(measured)
    )
    checks = []
    if table.equals is not None:
        checks.append(
            isinstance(measured, bool) == isinstance(table.equals, bool)
            and measured == table.equals
        )
    if table.min is not None:
        checks.append(number and measured >= table.min)  # type: ignore[operator]
    if table.max is not None:
        checks.append(number and measured <= table.max)  # type: ignore[operator]
    if table.contains is not None:
        text = (
            measured
            if isinstance(measured, str)
            else json.dumps(measured, ensure_ascii=False)
        )
        checks.append(table.contains in text)
    return all(checks)
