"""The study of a stored result: its own text, without code, or the file that is given."""

from __future__ import annotations

from pathlib import Path

from oed.result import StudyResult
from pkm_studies import user_code
from pkm_studies.base import Location
from pkm_studies.earlier_result import machine_difference
from pkm_studies.resolve import study_machine
from pkm_studies.study import SUFFIX, Study, load, parse
from pkm_studies.user_code import Consent


def result_study(
    result: StudyResult,
    folder: Path,
    study_file: Path | None,
    consent: Consent = Consent.RECORDED,
) -> Study:
    """The study in a file, or that which the result in a folder holds.

    consent  to run Python files that the file names; the result's own study never runs
             one

    Raises InputError where the result does not hold its study, where its machine is a
    Python file, and where the file is the study of another machine.
    """
    location = Location(str(folder / "result.json"))
    if study_file is not None:
        return _given_study(result, study_file, consent, location)
    if not result.study_text:
        raise location.error("this result holds no study", "give it: --study STUDY")
    path = folder / f"{result.study}{SUFFIX}"
    study = parse(result.study_text, path, Consent.NEVER)
    model = study.machine.model
    if user_code.is_file(model):
        raise location.error(
            f"the machine is the Python file {user_code.file_name(model)}, and a result"
            " runs no code",
            "give the study: --study STUDY",
        )
    return study


def _given_study(
    result: StudyResult, study_file: Path, consent: Consent, location: Location
) -> Study:
    """The study of a file, if it is that of the result's machine."""
    study = load(study_file, consent)
    difference = machine_difference(result.machine, study_machine(study))
    if difference is None:
        return study
    raise location.error(
        f"the machine of {study_file} is not that of this result: {difference}",
        "give the study that the result was made with",
    )
