"""Checks studies against their machine, and readings against their study."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oed import checks
from oed.fit_limits import ALARM_PROBABILITY
from oed.mechanism import AssemblyError, Kinematics, closest_closure
from oed.model import Machine
from pkm_studies import catalogue, files, quantities, shipped, sources, stages
from pkm_studies.base import InputError, Location, SourceAbsentError, Stream
from pkm_studies.resolve import (
    ResolvedStudy,
    check_home,
    resolve,
    study_machine,
    unreachable,
)
from pkm_studies.study import Study
from pkm_studies.user_code import Consent, Origin

if TYPE_CHECKING:
    from oed.dataset import Dataset
    from oed.result import ClosestClosure


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What a file holds."""

    content: str  #: in a sentence
    #: what is wrong with its readings, the most harmful first
    findings: Sequence[str] = ()
    remarks: Sequence[str] = ()  #: what a user should know


def check(
    paths: Sequence[Path], consent: Consent = Consent.RECORDED
) -> Iterator[tuple[Path, Verdict | InputError]]:
    """For each file what it holds, or what is wrong.

    consent  to run Python files, and those that the studies name

    Readings are checked against the studies among the files.
    """
    resolved: list[ResolvedStudy] = []
    alone = all(p.suffix != ".csv" for p in paths)
    has_study = any(p.suffix not in (".csv", ".py") for p in paths)
    # machines first, then studies, then readings
    for path in sorted(paths, key=lambda p: {".py": 0, ".csv": 2}.get(p.suffix, 1)):
        try:
            if path.suffix == ".py":
                verdict = _check_machine(path, consent)
            elif path.suffix == ".csv":
                verdict = _check_readings(path, resolved, has_study=has_study)
            else:
                verdict = _check_study(path, consent, resolved, alone=alone)
        except InputError as error:
            yield path, error
        else:
            yield path, verdict


def _check_machine(path: Path, consent: Consent) -> Verdict:
    """A machine's file: its functions fit one another, and its home pose assembles."""
    location = Location(str(path))
    machine = catalogue.machine(str(path), Origin.command(consent), location)
    kinematics = Kinematics(machine)
    check_home(kinematics, location)
    return Verdict(
        f"sound: {machine.name} has {len(machine.joints)} joints and"
        f" {len(machine.parameters)} parameters, and closes at its home pose",
        remarks=_doubts(kinematics),
    )


def _doubts(kinematics: Kinematics) -> list[str]:
    """Sentences on a machine whose ranges or lengths do not fit one another."""
    sentences = doubtful_lengths(kinematics.machine), unreachable(kinematics)
    return [sentence for sentence in sentences if sentence]


#: times what a machine moves by beyond which a length is in doubt: a long arm has ten
#: times its stroke, and mm in place of m a thousand
VERY_LONG = 100.0


def doubtful_lengths(machine: Machine) -> str | None:
    """A sentence on a parameter that is very long beside the machine; None without."""
    moved = [c for c in (*machine.command, *machine.joints) if c.unit == "m"]
    ends = np.abs([(c.lower, c.upper) for c in moved]).ravel()
    size = max([*ends[np.isfinite(ends)], machine.lever])
    lengths = [p for p in machine.parameters if p.unit == "m"]
    longest = max(lengths, key=lambda p: abs(p.nominal), default=None)
    if longest is None or abs(longest.nominal) < VERY_LONG * size:
        return None
    length, whole = (quantities.format_value(v, "m") for v in (longest.nominal, size))
    return (
        f"{longest.name} is {length}, and nothing of the machine moves beyond {whole}:"
        " lengths of a machine's file are in m"
    )


def _check_study(
    path: Path, consent: Consent, resolved: list[ResolvedStudy], *, alone: bool
) -> Verdict:
    """What a study holds, by the studies that are `resolved`; or stands `alone`."""
    study = Study.load(shipped.study_path(path), consent)
    try:
        # without readings first: others can be checked even where these are absent
        without_readings = resolve(study, readings=())
        without_readings.check_effect_names()
        resolved.append(without_readings)
        complete = without_readings.with_stated_readings()
        remarks = stages.check_inputs(complete)
        counts = {
            "set-up": len(complete.setups),
            "candidate": sum(len(s) for s in complete.candidates),
            "reading": _n_readings(complete.dataset) if complete.dataset else 0,
            "claim": len(study.expect),
        }
        parts = [f"{n} {what}{'s' if n > 1 else ''}" for what, n in counts.items() if n]
        sentences = [f"sound: {', '.join(parts)}", *complete.warnings]
        if complete.has_own_numbers:
            sentences += _doubts(complete.measurement.kinematics)
        content = "; ".join(sentences)
        if complete.dataset is not None:
            return _add_findings(content, complete, complete.dataset)
        if alone:
            remarks += _unseen(complete)
        return Verdict(content, remarks=remarks)
    except SourceAbsentError as error:
        problem = f"the study is sound, but its data is missing: {error.problem}"
        return Verdict(problem)
    except AssemblyError as error:
        remedy = "check the machine's numbers and the poses"
        raise InputError(str(error), remedy, file=str(path)) from error


def _add_findings(content: str, study: ResolvedStudy, data: Dataset) -> Verdict:
    checked = stages.check_dataset(study, data, _rng(study))
    findings = [f.sentence for f in checked.findings if not f.is_remark]
    remarks = [f.sentence for f in checked.findings if f.is_remark]
    stated = checked.as_stated
    if stated is not None and stated.p_high < ALARM_PROBABILITY:
        remarks.append(
            f"The residuals are {stated.ratio:.2g} times the stated noise. Correlated or"
            " larger noise may explain that, or an effect that the model lacks:"
            " `oed diagnose` compares them."
        )
    return Verdict(content, findings, remarks)


def _unseen(study: ResolvedStudy) -> list[str]:
    """Mistakes that readings of the first reference plan cannot reveal."""
    if not study.reference_plans:
        return []
    plan = study.reference_plans[0]
    measurement = study.measurement_with(plan.setups)
    series = tuple(plan.series)
    exact = measurement.readings(series, measurement.nominal)
    session = checks.session_readings(measurement, series, exact)
    everything = study.measurement_with(study.setups)
    unseen = checks.unseen_mistakes(session, everything, _rng(study))
    return [
        f"Readings of {plan.name} cannot reveal this mistake: {what}."
        for what in unseen
    ]


def _rng(study: ResolvedStudy) -> np.random.Generator:
    return Stream.CHECKS.rng(study.study.seed)


def _n_readings(data: Dataset) -> int:
    """Number of readings, rows of the readings file: each has a value a channel."""
    return sum(len(series) for series in data.series)


def _check_readings(
    path: Path, resolved: Sequence[ResolvedStudy], *, has_study: bool
) -> Verdict:
    """What a readings file holds, by the studies that name it, or by all."""
    if not resolved:
        rows = sources.check_text(path)
        rest = (
            "set-ups, poses and units are checked once the study has no error"
            if has_study
            else "give the study as well to check set-ups, poses and units"
        )
        return Verdict(f"{rows} rows are sound as text; {rest}")
    naming = [r for r in resolved if _names_file(r.study, path)]
    contents: list[str] = []
    findings: list[str] = []
    remarks: list[str] = []
    for study in naming or resolved:
        measurement = study.measurement_with(study.setups)
        data = sources.read_files([path], measurement)
        content = f"{_n_readings(data)} readings fit the columns of {study.study.name}"
        verdict = _add_findings(content, study, data)
        contents.append(verdict.content)
        findings += verdict.findings
        remarks += verdict.remarks
    return Verdict("; ".join(contents), findings, remarks)


def _names_file(study: Study, path: Path) -> bool:
    files = study.readings.files if study.readings else []
    return any((study.folder / name).resolve() == path.resolve() for name in files)


# `oed check STUDY --picture FILE`: the machine at its guess, and what stays open.

KINDS = (".png", ".svg", ".pdf")


def draw_machine(path: Path, picture: Path, consent: Consent = Consent.RECORDED) -> str:
    """Write the picture of a machine; what it shows. Raises InputError."""
    if picture.suffix.lower() not in KINDS:
        problem = "no kind of picture"
        remedy = f"end its name in {', '.join(KINDS)}"
        raise InputError(problem, remedy, field="--picture", value=picture.name)
    files.check_new(picture)
    machine = _machine(path, consent)
    closure = closest_closure(machine, machine.home_command)
    phrase = _closure_phrase(machine, closure)
    from pkm_reports import style
    from pkm_reports.sections import draw_closure

    title = f"{machine.name} {phrase.partition(':')[0]}"
    with style.applied():
        figure = draw_closure(closure, title, [c.name for c in machine.joints])
        content, kind = io.BytesIO(), picture.suffix[1:].lower()
        figure.savefig(content, format=kind, dpi=style.PIXELS_PER_INCH)
    files.write_whole(picture, content.getvalue())
    return f"{picture}: {phrase}"


def _machine(path: Path, consent: Consent) -> Machine:
    """The machine as stated, whether or not it assembles."""
    if path.suffix == ".py":
        location = Location(str(path))
        machine: Machine = catalogue.machine(
            str(path), Origin.command(consent), location, assembled=False
        )
        return machine
    return study_machine(Study.load(shipped.study_path(path), consent), assembled=False)


def _closure_phrase(machine: Machine, closure: ClosestClosure) -> str:
    """What stays open, or why the solver refuses what closes."""
    if closure.still_open:
        parts = []
        for k in closure.still_open:
            joints = ", ".join(closure.joints[k])
            missed = abs(closure.nearest.equations[k])
            name = f"equation {k + 1} ({joints})" if joints else f"equation {k + 1}"
            amount = f"by {missed:.3g}" if np.isfinite(missed) else "has no value"
            parts.append(f"{name} {amount}")
        return f"does not close at its home pose: {', '.join(parts)} (m or rad)"
    try:
        Kinematics(machine).inverse(machine.home_command)
    except AssemblyError as error:
        return f"closes at its home pose, but the solver does not get there: {error}"
    return "closes at its home pose"
