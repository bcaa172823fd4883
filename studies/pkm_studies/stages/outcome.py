"""What the command prints of a result, and the exit code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from oed.base import own_files
from oed.result import trust
from pkm_studies.base import console

if TYPE_CHECKING:
    from oed.result import Claim, StudyResult

DONE, FAILED, BAD_INPUT = 0, 1, 2


def report_outcome(result: StudyResult, folder: Path, quiet: bool) -> int:
    """Print headline, files and claims; the exit code."""
    if not quiet:
        from pkm_studies.stages import accuracy_table, headline, result_folder

        accuracy_table.print_accuracy(result)
        tabled = headline.accuracy_sentences(result)
        for sentence in result.headline:
            if sentence not in tabled:
                print(sentence)
        for warning in result.warnings:
            if warning not in result.headline:
                print(f"Warning: {_sentence(warning)}")
        for sentence in result_folder.changed_files(folder):
            print(f"Warning: {_sentence(sentence)}")
        names = ("report.html", "report.pdf", "result.json")
        paths = [own_files.latest(folder / name) for name in names]
        print(f"Report: {', '.join(str(p) for p in paths if p.is_file())}")
        for name in result.written:
            if name.startswith("poses"):
                print(f"To fill in: {folder / name}")
        for claim in result.claims:
            print(f"Claim {_verdict(claim)}")
    failing = [claim for claim in result.claims if not claim.met]
    for claim in failing:
        console.print_error(f"claim {_verdict(claim)}")
    objections = trust.objections(result)
    for objection in objections:
        console.print_error(f"{objection}; nothing that rests on it can be trusted")
    return FAILED if failing or objections else DONE


def _sentence(text: str) -> str:
    """A capital first letter, and a full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def _verdict(claim: Claim) -> str:
    if claim.met and isinstance(claim.measured, str):
        return f"{claim.claim}: met: {claim.wanted}"
    measured = claim.measured
    if isinstance(measured, float):
        measured = f"{measured:.6g}"
    met = "met" if claim.met else "not met"
    return f"{claim.claim}: {met}: {claim.wanted}, measured {measured}"
