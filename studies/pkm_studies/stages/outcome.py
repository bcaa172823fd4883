"""What the command prints of a result, and the exit code."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pkm_studies import console
from pkm_studies.console import DONE, FAILED

if TYPE_CHECKING:
    from oed.result import Claim, StudyResult


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
        from pkm_studies.stages import summary

        print(*summary.lines(result, folder, verbose, above), sep="\n")
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
