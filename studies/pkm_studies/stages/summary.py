"""Summarises a result for the terminal: what decides, in 25 lines, or every sentence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from oed.base import own_files
from pkm_studies import console, result_folder
from pkm_studies.stages import accuracy_table, headline, outcome
from pkm_studies.stages.plan.phrases import plan_sentences

if TYPE_CHECKING:
    from oed.result import StudyResult

#: lines of the terminal that a summary takes
MOST_LINES: Final = 25
#: names of the files that a user opens
PAGES: Final = ("report.html", "report.pdf", "result.json")


def lines(
    result: StudyResult, folder: Path, verbose: bool, above: Sequence[str] = ()
) -> list[str]:
    """Tables, findings, warnings, files and claims.

    A summary lacks details, and the fit's residuals where there is no room for them; its
    last line says so. Warnings, verdicts, files and claims
    that are not met are always there.
    """
    table = [*above, *accuracy_table.accuracy_lines(result)]
    tabled = headline.accuracy_sentences(result)
    if above and result.plan is not None:
        tabled += [*plan_sentences(result.plan)[:1], " ".join(result.plan.needs)]
    findings = [words for words in result.headline if words not in tabled]
    rest = [*_warnings(result, folder), *_files(result, folder)]
    claims = [f"Claim {outcome.verdict(claim)}" for claim in result.claims]
    if verbose:
        return [*table, *findings, *rest, *claims]
    details = headline.detail_sentences(result)
    shown = [words for words in findings if words not in details]
    rest = [*_held_out(result), *rest, *_claims(result)]
    if _height([*table, *shown, *rest]) >= MOST_LINES:
        residuals = headline.fit_sentences(result)
        shown = [words for words in shown if words not in residuals]
    complete = len(findings) == len(shown) and not above and not result.claims
    more = [] if complete else ["--verbose prints every sentence and claim."]
    return [*table, *shown, *rest, *more]


def _height(printed: Sequence[str]) -> int:
    width = console.terminal().width
    return sum(console.height(line, width) for line in printed)


def _held_out(result: StudyResult) -> list[str]:
    """Channels of held-out readings that do not contradict the fit, in one sentence."""
    sections = [s for s in result.held_out if s.verdict in headline.FITTING]
    if not sections:
        return []
    confirming = sum(section.verdict == "confirms" for section in sections)
    inside = sorted(round(100.0 * section.coverage) for section in sections)
    words = f"{len(sections)} of {len(result.held_out)} channels agree with the fit"
    words += f", {confirming or 'none'} of them better than with the nominal numbers"
    ends = dict.fromkeys((inside[0], inside[-1]))
    shares = " to ".join(map(str, ends))
    return [
        f"Held-out readings: {words}; {shares} % of each are inside the predicted 95 %."
    ]


def _warnings(result: StudyResult, folder: Path) -> list[str]:
    """Warnings that the headline does not state, and files that stay."""
    stated = [words for words in result.warnings if words not in result.headline]
    sentences = [*stated, *result_folder.changed_files(folder)]
    return [f"Warning: {_sentence(words)}" for words in sentences]


def _files(result: StudyResult, folder: Path) -> list[str]:
    """The files that a user opens, and those to fill in."""
    paths = [own_files.latest(folder / name) for name in PAGES]
    sheets = [name for name in result.written if name.startswith("poses")]
    return [
        f"Report: {', '.join(str(p) for p in paths if p.is_file())}",
        *[f"To fill in: {folder / name}" for name in sheets],
    ]


def _claims(result: StudyResult) -> list[str]:
    """How many claims are met, and each that is not."""
    if not result.claims:
        return []
    failing = [claim for claim in result.claims if not claim.met]
    met = len(result.claims) - len(failing)
    return [
        f"Claims: {met} of {len(result.claims)} met.",
        *[f"Claim {outcome.verdict(claim)}" for claim in failing],
    ]


def _sentence(text: str) -> str:
    """A capital first letter, and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."
