"""Check files without running anything: studies against their machine, readings against
the study they are for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from oed.kinematics import AssemblyError
from pkm_studies import sources
from pkm_studies.errors import InputError, SourceAbsentError
from pkm_studies.resolve.resolved import ResolvedStudy, resolve
from pkm_studies.study import Study, load


def check(paths: Sequence[Path]) -> Iterator[tuple[Path, str | InputError]]:
    """For each file what was found, or what is wrong. Readings are checked against the
    studies among the files.
    """
    known: list[ResolvedStudy] = []
    for path in [p for p in paths if p.suffix != ".csv"]:
        yield path, _guarded(partial(_study, path, known))
    for path in [p for p in paths if p.suffix == ".csv"]:
        yield path, _guarded(partial(_readings, path, known))


def _guarded(work: Callable[[], str]) -> str | InputError:
    try:
        return work()
    except InputError as error:
        return error


def _study(path: Path, known: list[ResolvedStudy]) -> str:
    said = load(path)
    try:
        known.append(
            resolve(said, readings=())
        )  # so that its readings can be checked even where others are absent
        found = resolve(said)
    except SourceAbsentError as error:
        return f"the study is sound, but its data is missing: {error.problem}"
    except AssemblyError as error:
        raise InputError(
            str(error), "check the machine's numbers and the poses", file=str(path)
        ) from error
    return _told(said, found)


def _told(said: Study, found: ResolvedStudy) -> str:
    counts = {
        "set-up": len(found.setups),
        "candidate": sum(len(s) for s in found.candidates),
        "reading": len(found.dataset) if found.dataset else 0,
        "claim": len(said.expect),
    }
    parts = [f"{n} {what}{'s' if n > 1 else ''}" for what, n in counts.items() if n]
    return "sound: " + ", ".join(parts) + "".join(f"; {w}" for w in found.warnings)


def _readings(path: Path, known: Sequence[ResolvedStudy]) -> str:
    naming = [r for r in known if r.study.readings and _names(r.study, path)]
    if not (naming or known):
        rows = sources.check_text(path)
        return (
            f"{rows} rows are sound as text; give the study as well to check set-ups,"
            " poses and units"
        )
    told = []
    for one in naming or known:
        found = sources.from_files([path], one.measurement_with(one.setups))
        told.append(f"{len(found)} readings fit {one.study.name}")
    return "; ".join(told)


def _names(study: Study, path: Path) -> bool:
    named = study.readings.files if study.readings else []
    return any((study.folder / n).resolve() == path.resolve() for n in named)
