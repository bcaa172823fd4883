"""Reads the second visit that a diagnosis advises from its result, in lines."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

from oed import units
from oed.result import ChosenRun, GapSection, StudyResult
from pkm_studies.base import InputError
from pkm_studies.result_folder import VISIT
from pkm_studies.results import load_result
from pkm_studies.study import Study


def visit_lines(study: Study, named: Path, folder: Path) -> list[str]:
    """What the visit is worth, its runs, and the file to fill in.

    named   the study as the user gave it: its path, or the name of a shipped one
    folder  that of the diagnosis

    Raises InputError where the folder holds no diagnosis of this study.
    """
    result = load_result(folder)
    gap = _diagnosis(study, result, folder)
    visit = gap.second_visit
    if visit is None:
        return [
            "No second visit is advised: the first answer is sure, or no run of those"
            " read so far makes it clearer.",
            *gap.next,
        ]
    table = str(folder / VISIT)
    phrases = ["diagnose", str(named), "--readings", table, "--after", str(folder)]
    return [
        *visit.words,
        "",
        *(
            f"  {run.setup}: {run.run}: {count} poses{_condition(run)}"
            for run, count in zip(visit.runs, visit.poses, strict=True)
        ),
        "",
        f"Fill in {table}, then: oed {shlex.join(phrases)} --out DIR",
    ]


def _diagnosis(study: Study, result: StudyResult, folder: Path) -> GapSection:
    if result.gap is None or result.study != study.name:
        content = "no diagnosis" if result.gap is None else f"study {result.study}"
        raise InputError(
            f"that is not a diagnosis of {study.name}: {content}",
            "name a folder that `oed diagnose` wrote for this study",
            field="--after",
            value=str(folder),
        )
    return result.gap


def _condition(run: ChosenRun) -> str:
    phrase = list(_words(run.condition))
    return f" ({', '.join(phrase)})" if phrase else ""


def _words(condition: Mapping[str, float]) -> Iterator[str]:
    if "direction" in condition:
        yield f"direction {condition['direction']:+.0f}"
    if "feed" in condition:
        yield f"{condition['feed'] / units.MM_PER_MIN:g} mm/min"
    if "payload" in condition:
        yield f"{condition['payload']:g} N"
