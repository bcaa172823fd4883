"""Several results side by side: two plans, before and after, sessions of one machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from oed.result import StudyResult
from pkm_reports.blocks import Block, Items, Section
from pkm_reports.comparison import glance, tables
from pkm_reports.page import Content, Document
from pkm_reports.report import write_document


def write_comparison(
    results: Mapping[str, StudyResult], out: Path, changes: Sequence[str] = ()
) -> tuple[Path, ...]:
    """Write `comparison.html` and `comparison.pdf` of results by name; their paths.

    changes    what changed between two sessions of one machine, in sentences

    Raises ValueError for fewer than two results, OSError where the folder cannot be
    written.
    """
    if len(results) < 2:
        raise ValueError("a comparison needs two results or more")
    return write_document(Document(content(results, changes)), out, "comparison")


def content(results: Mapping[str, StudyResult], changes: Sequence[str]) -> Content:
    """The text of a comparison, its first page the differences."""
    machines = list(dict.fromkeys(r.machine.name for r in results.values()))
    versions = list(dict.fromkeys(r.version for r in results.values()))
    names = list(results)
    return Content(
        title=f"{', '.join(names[:-1])} and {names[-1]} side by side",
        question="What differs, and which is better?",
        study="comparison",
        machine=", ".join(machines),
        foot=f"comparison · pkm-oed {', '.join(versions)}",
        answer=_present(
            Section("differences", "What differs", glance.sentences(results)),
            Section("changes", "What changed in the machine", _changes(changes)),
            Section("glance", "At a glance", glance.blocks(results)),
            Section("side-accuracy", "How accurate", tables.accuracy_blocks(results)),
        ),
        chapters=_present(
            Section("side-plans", "Plans", tables.blocks(results)),
            Section("side-parameters", "Parameters", tables.parameter_blocks(results)),
            Section("side-causes", "Causes", tables.cause_blocks(results)),
        ),
        appendix=[],
    )


def _changes(changes: Sequence[str]) -> list[Block]:
    return [Items(list(changes))] if changes else []


def _present(*sections: Section) -> list[Section]:
    return [section for section in sections if section.blocks]
