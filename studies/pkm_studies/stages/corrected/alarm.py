"""What the alarms of a bad fit become where the fit with effects is good.

The check looked at a fit without effects. Where parameters and effects together fit, the
alarm would be untrue of the values that count.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from oed.checks import CheckFinding, Severity
from oed.checks.explain import PHYSICAL
from oed.result import CorrectedSection, GoodnessSection


def resolves(corrected: CorrectedSection, findings: Sequence[CheckFinding]) -> bool:
    """Whether the fit with effects is good, and no finding remains that spoils it."""
    return not corrected.warnings and all(
        f.severity > Severity.BAD_FIT or _is_about_the_fit(f) for f in findings
    )


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
    ratio = (corrected.chi2 / corrected.dof) ** 0.5 if corrected.dof > 0.0 else 1.0
    effects = " and ".join(corrected.constants)
    opening = (
        f"With {effects} in the model the residuals are {ratio:.2g} times the stated"
        " noise, and the corrected values count."
    )
    return {
        f.sentence: f"{opening} Without: {f.sentence[:1].lower()}{f.sentence[1:]}"
        for f in findings
        if _is_about_the_fit(f)
    }


def _is_about_the_fit(finding: CheckFinding) -> bool:
    """Whether an effect of the machine may be behind a finding."""
    kinds = ("fit", *PHYSICAL)
    return finding.severity <= Severity.BAD_FIT and finding.kind in kinds
