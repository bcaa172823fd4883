"""Stored results: read, held against the study's claims, and their advice on a budget.

load_result          the result of a folder
read_result          the result of a file
BadFitError          a fit that promises nothing: an exit of its own
refuse_bad_fit       raises it where nothing may rest on a result's fit
Estimated            a section with parameters and their covariance
estimated_section    that of a result
check_claims         the claims of a study, held against its result
check_claim          one of them
value_at             the value of a result at a claim's path
Values               an accuracy by component, in its unit
advice_on            what brings most: the lines of a budget in sentences
error_quantities     an accuracy in words
error_ratio          the size of an accuracy beside another's
unmodelled_sentence  what errors beside the model's parameters add
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from oed import trust
from oed.result import (
    BudgetLine,
    Claim,
    CorrectedSection,
    EstimateSection,
    StudyResult,
    breaches,
)
from oed.text import shorten, suggest
from pkm_studies import files
from pkm_studies.base import Location, check_name
from pkm_studies.tables import ClaimTable, StudyFile

# Checks the claims of a study on its result.

#: numbers of result.json that are in the `unit` which stands beside them
IN_UNIT = ("rms", "rms_raw", "p95", "max", "value", "sd", "mean", "q025", "q975")
MAX_TEXT_CHARACTERS = 200  #: most characters of a measured text


def check_claims(
    study: StudyFile, result: Mapping[str, Any], only: tuple[str, ...] | None = None
) -> list[Claim]:
    """Each claim of [expect], in order, of the sections `only`, on a result as tables."""
    claims = []
    for name, table in study.expect.items():
        section = re.split(r"[.\[]", table.of)[0]
        if only is None or section in only:
            claims.append(check_claim(name, table, result))
    return claims


def check_claim(name: str, table: ClaimTable, result: Mapping[str, Any]) -> Claim:
    """A claim on a result as plain tables and lists."""
    wanted = f"{table.of} {_wanted(table)}"
    try:
        value = value_at(result, table.of)
    except LookupError as error:
        measured = shorten(str(error), MAX_TEXT_CHARACTERS)
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
    """The value at a path. Raises LookupError that says how far the path leads."""
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
                start = max(0, sentence.index(wanted) - MAX_TEXT_CHARACTERS // 4)
                lead = "... " if start else ""
                return shorten(lead + sentence[start:], MAX_TEXT_CHARACTERS)
    return shorten(
        value if isinstance(value, str) else json.dumps(value), MAX_TEXT_CHARACTERS
    )


def _texts(value: object) -> Iterator[str]:
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


# What an uncertainty budget says, in sentences: what to improve, what the model lacks.

#: share of the error below which an improvement is not worth a sentence
MIN_WORTHWHILE_IMPROVEMENT = 0.02
MAX_ADVICE = 2  #: sentences on what to improve
#: improvements in words, by kind of line
IMPROVEMENTS = {
    "prior": "half the tolerances of the machine's parameters",
    "interpolation": "a fine enough table",
    "rounding": "half the step of the printed digits, and of what the model misses,",
    "left out": "a file that holds the effects",
}

Values = Mapping[str, float]  #: rms errors by component, in its fine unit


def advice_on(
    lines: Sequence[BudgetLine], predicted: Values, components: Mapping[str, str]
) -> list[str]:
    """The improvements of components {name: unit} that bring most, in sentences."""
    sentences = []
    best = improvements(lines, predicted, components)
    for number, (improvement, after) in enumerate(best):
        order = "Improve first" if number == 0 else "Then"
        sentences.append(
            f"{order}: {improvement} brings {error_quantities(after, components)} instead of"
            f" {error_quantities(predicted, components)}."
        )
    return sentences


def improvements(
    lines: Sequence[BudgetLine], predicted: Values, components: Mapping[str, str]
) -> list[tuple[str, Values]]:
    """What brings most for components {name: unit}, in words, the best first."""
    ranked: list[tuple[float, str, Values]] = []
    for line in lines:
        better = line.halved or line.without
        if better is not None:
            gain = error_ratio(better, predicted, components)
            ranked.append((gain, _improvement(line), better))
    ranked.sort(key=lambda entry: entry[0])
    best: dict[str, Values] = {}
    for gain, improvement, after in ranked:
        if gain < 1.0 - MIN_WORTHWHILE_IMPROVEMENT:
            best.setdefault(improvement, after)  # several lines may have the same one
    return [*best.items()][:MAX_ADVICE]


def error_ratio(changed: Values, whole: Values, components: Mapping[str, str]) -> float:
    """Geometric mean of changed over whole errors of some components."""
    logs = [
        math.log(changed[name] / whole[name])
        for name in components
        if whole[name] > 0.0 and changed[name] > 0.0
    ]
    return math.exp(sum(logs) / len(logs)) if logs else 1.0


def _improvement(line: BudgetLine) -> str:
    if line.kind in IMPROVEMENTS:
        return IMPROVEMENTS[line.kind]
    if line.halved is None:
        return "a known set-up" if line.kind == "set-up" else f"known {line.source}"
    return f"half the {line.source}"


def error_quantities(values: Values, components: Mapping[str, str]) -> str:
    """Values of components {name: unit} in words."""
    parts = [f"{name} {values[name]:.3g} {unit}" for name, unit in components.items()]
    return ", ".join(parts)


# Reads stored results, and refuses bad fits; loads nothing that computes or draws.

MAX_BYTES = 1 << 28  #: bytes of the largest result that is read


Estimated = EstimateSection | CorrectedSection


class BadFitError(Exception):
    """The fit is too bad for what is asked of it."""


def load_result(folder: Path) -> StudyResult:
    """The result in a folder, absent keys at their defaults. Raises InputError."""
    path = folder / "result.json"
    result = read_result(path)
    for breach in breaches(result):
        raise Location(str(path), breach.field).error(
            f"this result contradicts itself: {breach.problem}",
            "it was changed after it was written: make it again, or restore the entry",
        )
    return result


def read_result(path: Path) -> StudyResult:
    """The result in a file, as it stands there. Raises InputError as `load_result`."""
    text, location = (
        files.read_text(path, limit=MAX_BYTES, what="result"),
        Location(str(path)),
    )
    try:
        result = msgspec.json.decode(text, type=StudyResult)
    except msgspec.DecodeError as error:
        raise location.error(
            f"this is no result: {error}", "make it again with `oed run`"
        ) from error
    check_name(result.study, location.key("study"))
    return result


def estimated_section(result: StudyResult, folder: Path) -> Estimated:
    """The corrected estimate where there is one, which effects do not bend.

    folder  of the result, for errors. Raises InputError without a covariance.
    """
    section = result.final_estimate
    if section is None or not section.covariance:
        raise Location(str(folder / "result.json")).error(
            "this result has no estimate with its covariance",
            "make it with `oed identify STUDY --readings CSV --out DIR`",
        )
    return section


def refuse_bad_fit(result: StudyResult) -> None:
    """Raises BadFitError where the fit promises nothing."""
    objections = trust.objections(result)
    if objections:
        raise BadFitError(
            f"{'; '.join(objections)}: such a fit promises no accuracy;"
            f" {trust.remedy(result)}"
        )
