"""What a terminal prints of a result, and the exit code."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from oed import safe_files
from pkm_studies import console, result_folder
from pkm_studies.console import DONE, FAILED
from pkm_studies.stages import headline

if TYPE_CHECKING:
    from oed.result import Claim, StudyResult
    from pkm_reports.blocks import Table

#: lines of a summary, which a terminal shows without scrolling
MOST_LINES: Final = 12
#: sentences of a result that has no first lines
MOST_SENTENCES: Final = 3
#: verdicts of held-out readings that raise no doubt of the fit
FITTING: Final = ("confirms", "agrees")
#: the one that is never summed up
CONTRADICTS: Final = "contradicts"
#: names of the files that a user opens
PAGES: Final = ("report.html", "report.pdf", "result.json")


def lines(
    result: StudyResult, folder: Path, verbose: bool, above: Sequence[str] = ()
) -> list[str]:
    """The first lines of the report, what speaks against them, files and claims.

    At most MOST_LINES lines, but for what speaks against the result; `verbose` prints
    every sentence, warning and claim.
    """
    from pkm_reports import first_lines

    page = first_lines(result)
    table = [] if page.table is None else _table(page.table)
    shown = [*above, *(page.sentences or result.headline[:MOST_SENTENCES]), *table]
    files = _files(result, folder, page.is_plan)
    if verbose:
        warnings = _warnings(result, folder)
        claims = [f"Claim {verdict(claim)}" for claim in result.claims]
        rest = [line for line in result.headline if line not in shown]
        return [*shown, *rest, *warnings, *files, *claims]
    contradictions = [
        f"{s.words}." for s in result.held_out if s.verdict == CONTRADICTS
    ]
    failing = [f"Claim {verdict(claim)}" for claim in result.claims if not claim.met]
    warnings = [*page.warnings, *result_folder.changed_files(folder)]
    # the most useful first, where not all have room
    ranked = [
        *[f"Next: {action}" for action in page.actions],
        *page.findings[:1],
        *headline.lost_directions(result.identifiability),
        *headline.noise_sentences(result),
        *headline.earlier_sentences(result.machine),
        *_held_out(result),
        *[f"Warning: {_sentence(warning)}" for warning in warnings],
        *page.findings[1:],
    ]
    needed = [*contradictions, *files, *failing]
    room = max(0, MOST_LINES - len(shown) - len(needed) - 1)
    return [*shown, *ranked[:room], *needed, _last_line(result, len(ranked[room:]))]


def _table(table: Table) -> list[str]:
    """A table of the report as lines; the sentence above says what it is of."""
    from rich.table import Table as Lines

    drawn = Lines(box=None, show_header=True, padding=(0, 1))
    for column in table.columns:
        drawn.add_column(column.title, justify="right" if column.number else "left")
    for row in table.rows:
        drawn.add_row(*row)
    return console.table_lines(drawn)


def _held_out(result: StudyResult) -> list[str]:
    """Channels of held-out readings that do not contradict the fit, in one sentence."""
    sections = [s for s in result.held_out if s.verdict in FITTING]
    if not sections:
        return []
    confirming = sum(section.verdict == "confirms" for section in sections)
    inside = sorted(round(100.0 * section.coverage) for section in sections)
    shares = " to ".join(map(str, dict.fromkeys((inside[0], inside[-1]))))
    return [
        f"Held-out readings agree with the fit in {len(sections)} of"
        f" {len(result.held_out)} channels, in {confirming or 'none'} better than with the"
        f" nominal numbers; {shares} % lie inside the predicted 95 %."
    ]


def _warnings(result: StudyResult, folder: Path) -> list[str]:
    """Warnings that the headline does not state, and files that stay."""
    stated = [
        sentence for sentence in result.warnings if sentence not in result.headline
    ]
    sentences = [*stated, *result_folder.changed_files(folder)]
    return [f"Warning: {_sentence(sentence)}" for sentence in sentences]


def _files(result: StudyResult, folder: Path, is_plan: bool) -> list[str]:
    """The files that a user opens, and those of a plan to fill in."""
    paths = [safe_files.latest(folder / name) for name in PAGES]
    sheets = [name for name in result.written if name.startswith("poses") and is_plan]
    return [
        f"Report: {', '.join(str(p) for p in paths if p.is_file())}",
        *[f"To fill in: {folder / name}" for name in sheets],
    ]


def _last_line(result: StudyResult, more: int) -> str:
    """How many claims are met, and where the lines are that have no room."""
    claims = ""
    if result.claims:
        met = sum(claim.met for claim in result.claims)
        claims = f"Claims: {met} of {len(result.claims)} met. "
    rest = f" ({more} more line{'s' * (more > 1)})" if more else ""
    return f"{claims}--verbose prints every sentence, warning and claim{rest}."


def _sentence(text: str) -> str:
    """A capital first letter, and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


# What the command prints of a result, and the exit code.


def report_outcome(
    result: StudyResult,
    folder: Path,
    quiet: bool,
    *,
    verbose: bool = False,
    above: Sequence[str] = (),
) -> int:
    """Print headline, files and claims, below the lines `above`; the exit code.

    It is 0 where nothing speaks against the result and what is wanted passes.
    """
    if not quiet:
        print(*lines(result, folder, verbose, above), sep="\n")
    from oed import trust
    from oed.verdict import all_pass

    failing = [claim for claim in result.claims if not claim.met]
    for claim in failing:
        console.print_error(f"claim {verdict(claim)}")
    objections = trust.objections(result)
    for objection in objections:
        console.print_error(
            f"{objection}: do not rely on its parameters, nor on what they predict"
        )
    passes = all_pass(v.judgement for v in result.verdicts.values())
    return DONE if passes and not failing and not objections else FAILED


def verdict(claim: Claim) -> str:
    """What was claimed, and what was measured."""
    if claim.met and isinstance(claim.measured, str):
        return f"{claim.claim}: met: {claim.wanted}"
    measured = claim.measured
    if isinstance(measured, float):
        measured = f"{measured:.6g}"
    met = "met" if claim.met else "not met"
    return f"{claim.claim}: {met}: {claim.wanted}, measured {measured}"
