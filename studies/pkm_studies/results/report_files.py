"""Writes reports of stored results, and comparisons of several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from oed.result import StudyResult
from pkm_studies.base import files
from pkm_studies.base.errors import InputError
from pkm_studies.results.stored_result import load_result


def write_report(
    folder: Path, *, html: bool = True, pdf: bool = True
) -> tuple[Path, ...]:
    """HTML and PDF reports of the result in a folder; their paths."""
    from pkm_reports import write_report

    return write_report(load_result(folder), folder, html=html, pdf=pdf)


def write_comparison(folders: Sequence[Path], out: Path) -> tuple[Path, ...]:
    """HTML and PDF of the results in several folders side by side; their paths.

    Two results of one machine, with estimates under one prior, are also compared as
    `oed compare` does. Raises InputError where a folder holds no result.
    """
    from pkm_reports import write_comparison

    loaded = [load_result(folder) for folder in folders]
    results = dict(zip(short_names(folders), loaded, strict=True))
    changes = _changes(folders, loaded) if len(folders) == 2 else []
    files.out_folder(out)
    return write_comparison(results, out, changes)


def short_names(folders: Sequence[Path]) -> list[str]:
    """A different name for each folder: its last parts, as few as tell them apart."""
    parts = [folder.resolve().parts for folder in folders]
    most = max(map(len, parts))
    for count in range(1, most + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{'/'.join(p[-1:])} ({k})" for k, p in enumerate(parts, 1)]


def _changes(folders: Sequence[Path], results: Sequence[StudyResult]) -> list[str]:
    """What changed between two sessions; nothing where they cannot be compared."""
    if results[0].machine.name != results[1].machine.name:
        return []
    if any(r.final_estimate is None for r in results):
        return []
    from pkm_studies.results import comparison

    try:
        return comparison.compare(*folders).sentences
    except InputError:
        return []
