"""What the alarms of a bad fit become where the fit with effects is good.

The check looked at a fit without effects. Where parameters and effects together fit, the
alarm would be untrue of the values that count.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from oed.checks import PHYSICAL_KINDS, CheckFinding, Severity
from oed.corrected import TurnedRuns
from oed.fit_limits import noise_ratio
from oed.result import CorrectedSection, GoodnessSection, MistakeRecord
from oed.text import rounded


def resolves(corrected: CorrectedSection, findings: Sequence[CheckFinding]) -> bool:
    """Whether the fit with effects is good, and no finding remains that spoils it."""
    return not corrected.warnings and may_be_resolved(findings)


def may_be_resolved(findings: Sequence[CheckFinding]) -> bool:
    """Whether effects may be behind every finding that spoils the fit."""
    return all(f.severity > Severity.BAD_FIT or is_about_the_fit(f) for f in findings)


def resolved_section(
    section: GoodnessSection,
    corrected: CorrectedSection,
    findings: Sequence[CheckFinding],
) -> GoodnessSection:
    """The section with the alarms as they are with the effects in the model."""
    renamed = resolved_sentences(corrected, findings)
    sentences = [renamed.get(sentence, sentence) for sentence in section.findings]
    return msgspec.structs.replace(section, findings=sentences, bad_fit=False)


def resolved_sentences(
    corrected: CorrectedSection, findings: Sequence[CheckFinding]
) -> dict[str, str]:
    """Alarms of the fit without effects, and what is true with them."""
    ratio = noise_ratio(corrected.chi2, corrected.dof)
    effects = " and ".join(corrected.constants)
    opening = (
        f"With {effects} in the model {_fit(ratio)}, and the corrected values count."
    )
    return sentences_with(opening, findings)


def _fit(ratio: float | None) -> str:
    if ratio is None:
        return "the readings fit"
    return f"the residuals are {rounded(ratio)} times the stated noise"


def sentences_with(opening: str, findings: Sequence[CheckFinding]) -> dict[str, str]:
    """Alarms of the fit without effects, each after what is true with them."""
    return {
        f.sentence: f"{opening} Without: {f.sentence[:1].lower()}{f.sentence[1:]}"
        for f in findings
        if is_about_the_fit(f)
    }


def turned_sentence(corrected: CorrectedSection, turned: TurnedRuns) -> str:
    """Which runs were driven the other way than their rows say."""
    names = ", ".join(run for _, run in turned.runs)
    runs, were = ("run", "was") if len(turned.runs) == 1 else ("runs", "were")
    effects = " and ".join(corrected.constants)
    return (
        f"The readings look mistaken: {runs} {names} {were} driven the other way than the"
        f" order of the rows says, or all others were (residuals with {effects}:"
        f" {rounded(turned.before)} times the stated noise; with the order of {names} reversed:"
        f" {rounded(turned.after)} times)."
    )


def add_turned_runs(
    section: GoodnessSection, corrected: CorrectedSection, turned: TurnedRuns
) -> GoodnessSection:
    """The section with that mistake as its first finding."""
    sentence = turned_sentence(corrected, turned)
    names = ", ".join(run for _, run in turned.runs)
    mistake = MistakeRecord(
        what=f"direction reversed: {names}",
        evidence=(
            f"residuals {turned.before:.3g} times the stated noise as given,"
            f" {turned.after:.3g} times with this undone"
        ),
    )
    return msgspec.structs.replace(
        section,
        findings=[sentence, *section.findings],
        mistakes=[mistake, *section.mistakes],
        bad_fit=True,
    )


def is_about_the_fit(finding: CheckFinding) -> bool:
    """Whether an effect of the machine may be behind a finding."""
    kinds = ("fit", *PHYSICAL_KINDS)
    return finding.severity <= Severity.BAD_FIT and finding.kind in kinds
