"""`oed check STUDY --picture FILE`: the machine at its guess, and what stays open."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from oed.mechanism import AssemblyError, Kinematics, closest_closure
from oed.model import Machine
from oed.result import ClosestClosure
from pkm_studies import catalogue, files, shipped
from pkm_studies.base import InputError, Location
from pkm_studies.resolve import study_machine
from pkm_studies.study import load
from pkm_studies.user_code import Consent, Origin

KINDS = (".png", ".svg", ".pdf")


def draw(path: Path, picture: Path, consent: Consent = Consent.RECORDED) -> str:
    """Write the picture of a study's machine, or of a machine's file; what it shows.

    Raises InputError where the machine's functions do not fit one another.
    """
    if picture.suffix.lower() not in KINDS:
        raise InputError(
            "no kind of picture",
            f"end its name in {', '.join(KINDS)}",
            field="--picture",
            value=picture.name,
        )
    files.check_new(picture)
    machine = _machine(path, consent)
    closure = closest_closure(machine, machine.home_command)
    phrase = _verdict(machine, closure)
    _save(machine, closure, phrase, picture)
    return f"{picture}: {phrase}"


def _machine(path: Path, consent: Consent) -> Machine:
    """The machine as stated, whether or not it assembles."""
    if path.suffix == ".py":
        location = Location(str(path))
        machine: Machine = catalogue.machine(
            str(path), Origin.command(consent), location, assembled=False
        )
        return machine
    return study_machine(load(shipped.study_path(path), consent), assembled=False)


def _save(
    machine: Machine, closure: ClosestClosure, phrase: str, picture: Path
) -> None:
    from pkm_reports import style
    from pkm_reports.sections import draw_closure

    title = f"{machine.name} {phrase.partition(':')[0]}"
    with style.applied():
        figure = draw_closure(closure, title, [c.name for c in machine.joints])
        content, kind = io.BytesIO(), picture.suffix[1:].lower()
        figure.savefig(content, format=kind, dpi=style.PIXELS_PER_INCH)
    files.write_whole(picture, content.getvalue())


def _verdict(machine: Machine, closure: ClosestClosure) -> str:
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
