"""comparison.html and comparison.pdf from several results side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from oed.result import StudyResult
from pkm_reports.page import Content, Document
from pkm_reports.sections import comparison_parts


def write_comparison(
    results: Mapping[str, StudyResult], out: Path, changes: Sequence[str] = ()
) -> tuple[Path, ...]:
    """Write HTML and PDF of results by name; their paths. Raises ValueError, OSError."""
    if len(results) < 2:
        raise ValueError("a comparison needs two results or more")
    return Document(content(results, changes)).write(out, "comparison")


def content(results: Mapping[str, StudyResult], changes: Sequence[str]) -> Content:
    """The text of a comparison, its first page the differences."""
    machines = list(dict.fromkeys(r.machine.name for r in results.values()))
    versions = list(dict.fromkeys(r.version for r in results.values()))
    names = list(results)
    answer, chapters = comparison_parts(results, changes)
    return Content(
        title=f"{', '.join(names[:-1])} and {names[-1]} side by side",
        question="What differs, and which is better?",
        study="comparison",
        machine=", ".join(machines),
        foot=f"comparison · pkm-oed {', '.join(versions)}",
        answer=answer,
        chapters=chapters,
        appendix=[],
    )
