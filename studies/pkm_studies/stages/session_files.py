"""Readings files of the sessions that a diagnosis rests on, kept with its result."""

from __future__ import annotations

import collections
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from oed.dataset import decode, is_counted, reading_digests
from pkm_studies import sources
from pkm_studies.base import InputError
from pkm_studies.results import load_result
from pkm_studies.stages.run_state import RunState
from pkm_studies.study import Study

#: name of the J-th file of the I-th session in the folder of a result
NAME = "session{}_{}.readings.csv"
PATTERN = re.compile(r"session(\d+)_\d+\.readings\.csv")


def add_sessions(
    state: RunState, readings: Sequence[Path] | None, after: Path | None
) -> RunState:
    """The state of a diagnosis with the texts of its readings files.

    With the folder `after` of an earlier diagnosis, the readings of that and `readings`
    are one dataset. Raises InputError where one of the two is missing.
    """
    latest = list(readings or _files_of(state.study))
    if after is None:
        return state.replace(session_files=_texts([latest]))
    if not latest:
        raise InputError(
            "there are no readings of a further session",
            "give --readings FILE.csv",
            field="--after",
            value=str(after),
        )
    resolved = state.resolved
    earlier, counted = _stored(after, resolved.machine.name)
    every = resolved.measurement_with(resolved.setups)
    further = resolved.fitted(sources.read_files(latest, every))
    new = reading_digests(further.series, further.y, resolved.setups)
    if is_counted(new, counted):
        raise InputError(
            "these readings are among those of that diagnosis: they would count twice",
            "give the readings of a further session",
            file=", ".join(map(str, latest)),
            field="--after",
            value=str(after),
        )
    sessions = [*earlier, latest]
    data, restarted = sources.read_sessions(sessions, every)
    return state.replace(
        resolved=resolved.with_dataset(data),
        session_files=_texts(sessions),
        readings_given=True,
    ).add_warnings(*_assumptions(restarted))


def _files_of(study: Study) -> list[Path]:
    """Readings files that a study names; none of a virtual machine or a collection."""
    table = study.readings
    if table is None or table.simulate or table.source is not None:
        return []
    return [study.folder / name for name in table.files]


def _stored(folder: Path, machine: str) -> tuple[list[list[Path]], list[str]]:
    """Files of each session of an earlier diagnosis, the earliest first.

    And the digests of their readings.
    """
    stored = load_result(folder)
    if stored.machine.name != machine:
        raise InputError(
            f"that is a result of the machine {stored.machine.name}",
            f"name one of {machine}",
            field="--after",
            value=str(folder),
        )
    sessions: dict[int, list[Path]] = collections.defaultdict(list)
    for name in sorted(stored.written):
        match = PATTERN.fullmatch(name)
        if match:
            sessions[int(match[1])].append(folder / name)
    if not sessions:
        raise InputError(
            "that result keeps no readings files",
            "diagnose its readings with `oed diagnose STUDY --readings FILE.csv --out"
            " DIR` first",
            field="--after",
            value=str(folder),
        )
    return [sessions[number] for number in sorted(sessions)], stored.readings


def _texts(sessions: Sequence[Sequence[Path]]) -> dict[str, str]:
    """Text of each file by its name in the folder of a result."""
    return {
        NAME.format(i, j): decode(path.read_bytes())
        for i, paths in enumerate(sessions, start=1)
        for j, path in enumerate(paths, start=1)
    }


def _assumptions(restarted: Sequence[int]) -> Iterator[str]:
    """What is taken for granted of sessions that are diagnosed together."""
    yield (
        "Sessions are taken together: a set-up of one name in several of them counts as"
        " left mounted. One that was mounted anew needs a name of its own"
    )
    for number in restarted:
        yield (
            f"The clock of session {number} starts again: it counts on from the end of"
            " the session before, so that what warmed up twice is no single course"
        )
