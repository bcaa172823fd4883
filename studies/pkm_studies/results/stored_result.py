"""Reads stored results, and refuses bad fits; loads nothing that computes or draws."""

from __future__ import annotations

from pathlib import Path

import msgspec

from oed import trust
from oed.result import StudyResult, breaches
from pkm_studies import files
from pkm_studies.base import Location, check_name

#: bytes of the largest result that is read
LIMIT = 1 << 28


class BadFitError(Exception):
    """The fit is too bad for what is asked of it."""


def load_result(folder: Path) -> StudyResult:
    """The result in a folder; keys that its file lacks have their defaults.

    Raises InputError where there is none, the file is no result, or it contradicts
    itself.
    """
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
        files.read_text(path, limit=LIMIT, what="result"),
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


def refuse_bad_fit(result: StudyResult) -> None:
    """Raises BadFitError where the fit promises nothing."""
    objections = trust.objections(result)
    if objections:
        raise BadFitError(
            f"{'; '.join(objections)}: such a fit promises no accuracy;"
            f" {trust.remedy(result)}"
        )
