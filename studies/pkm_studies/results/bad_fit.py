"""Refuses to rest anything on a bad fit."""

from __future__ import annotations

from oed.result import StudyResult, trust


class BadFitError(Exception):
    """The fit is too bad for what is asked of it."""


def refuse_bad_fit(result: StudyResult) -> None:
    """Raises BadFitError where the fit promises nothing."""
    objections = trust.objections(result)
    if objections:
        raise BadFitError(
            f"{'; '.join(objections)}: such a fit promises no accuracy;"
            f" {trust.remedy(result)}"
        )
