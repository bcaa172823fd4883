"""Checks studies against their machine, and readings against their study."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from oed.kinematics import AssemblyError
from pkm_studies import shipped, sources
from pkm_studies.errors import InputError, SourceAbsentError
from pkm_studies.resolve.machine import has_own_numbers, unreachable
from pkm_studies.resolve.resolved import ResolvedStudy, resolve
from pkm_studies.study import Study, load


def check(paths: Sequence[Path]) -> Iterator[tuple[Path, str | InputError]]:
    """For each file what it holds, or what is wrong.

    Readings are checked against the studies among the files.
    """
    resolved: list[ResolvedStudy] = []
    for path in [p for p in paths if p.suffix != ".csv"]:
        yield path, _verdict(partial(_check_study, path, resolved))
    for path in [p for p in paths if p.suffix == ".csv"]:
        yield path, _verdict(partial(_check_readings, path, resolved))


def _verdict(check_file: Callable[[], str]) -> str | InputError:
    try:
        return check_file()
    except InputError as error:
        return error


def _check_study(path: Path, resolved: list[ResolvedStudy]) -> str:
    """What a study holds; it joins the studies that are `resolved`."""
    study = load(shipped.study_path(path))
    try:
        # without readings first: others can be checked even where these are absent
        resolved.append(resolve(study, readings=()))
        return _content(study, resolve(study))
    except SourceAbsentError as error:
        return f"the study is sound, but its data is missing: {error.problem}"
    except AssemblyError as error:
        remedy = "check the machine's numbers and the poses"
        raise InputError(str(error), remedy, file=str(path)) from error


def _content(study: Study, resolved: ResolvedStudy) -> str:
    counts = {
        "set-up": len(resolved.setups),
        "candidate": sum(len(s) for s in resolved.candidates),
        "reading": len(resolved.dataset) if resolved.dataset else 0,
        "claim": len(study.expect),
    }
    parts = [f"{n} {what}{'s' if n > 1 else ''}" for what, n in counts.items() if n]
    sentences = [f"sound: {', '.join(parts)}", *resolved.warnings]
    if has_own_numbers(study.machine):
        sentence = unreachable(resolved.machine)
        sentences += [sentence] if sentence else []
    return "; ".join(sentences)


def _check_readings(path: Path, resolved: Sequence[ResolvedStudy]) -> str:
    """What a readings file holds, by the studies that name it, or by all."""
    if not resolved:
        rows = sources.check_text(path)
        return (
            f"{rows} rows are sound as text; give the study as well to check set-ups,"
            " poses and units"
        )
    naming = [r for r in resolved if _names_file(r.study, path)]
    verdicts = []
    for study in naming or resolved:
        measurement = study.measurement_with(study.setups)
        data = sources.from_files([path], measurement)
        verdicts.append(f"{len(data)} readings fit {study.study.name}")
    return "; ".join(verdicts)


def _names_file(study: Study, path: Path) -> bool:
    files = study.readings.files if study.readings else []
    return any((study.folder / name).resolve() == path.resolve() for name in files)
