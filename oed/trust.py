"""Whether a fit is to be trusted: one verdict for all that rests on a result.

Exit codes, reports, exports, acceptance tests, comparisons and campaigns ask here, and
judge nothing on their own. Fits and checks of readings have the same limits
(`oed.fit_limits`).
"""

from oed.fit_limits import (
    ALARM_PROBABILITY,
    FAR_TOLERANCES,
    GUESS_RATIO,
    chi2_is_large,
    noise_ratio,
)
from oed.result import (
    CompensationName,
    CorrectedSection,
    EstimateSection,
    GapSection,
    GoodnessSection,
    StudyResult,
)


def objections(result: StudyResult) -> list[str]:
    """Why nothing should rest on the fit of a result; none where it is to be trusted."""
    sentences = section_objections(
        result.goodness, result.estimate, result.corrected, result.gap
    )
    mixture = None if result.gap is None else result.gap.mixture
    section = mixture or result.final_estimate
    if section is not None and section.sent == CompensationName.NOTHING:
        sentences.append("no correction is expected to lessen the machine's errors")
    return sentences


def section_objections(
    goodness: GoodnessSection | None,
    estimate: EstimateSection | None,
    corrected: CorrectedSection | None = None,
    gap: GapSection | None = None,
) -> list[str]:
    """The same of the sections of a result."""
    final = corrected or estimate
    if final is None:
        return []
    far = far_parameters(final)
    sentences = []
    if goodness is not None and goodness.bad_fit:
        sentences.append(_check_reasons(goodness))
    if corrected is not None:
        sentences += corrected.warnings
    elif not sentences and estimate is not None:
        sentences += _residual_reasons(goodness, estimate)
    if far:
        sentences.append(
            f"these ended more than {FAR_TOLERANCES:.0f} tolerances from nominal: {', '.join(far)};"
            " the nominal numbers are those of another machine, or [prior] is too narrow"
        )
    if (
        corrected is None
        and gap is not None
        and gap.mixture is None
        and gap.effect_likely
    ):
        sentences.append(
            f"the diagnosis reports a gap ({gap.verdict}), which bends the parameters of"
            " a fit without it"
        )
    return sentences


def remedy(result: StudyResult) -> str:
    """What to do where there are objections; a diagnosis is not made twice."""
    if result.gap is None:
        return "run `oed diagnose`"
    return "do first what its diagnosis advises"


def far_parameters(section: EstimateSection | CorrectedSection) -> list[str]:
    """Parameters beyond FAR_TOLERANCES; none of a virtual machine."""
    if any(p.truth is not None for p in section.parameters.values()):
        return []
    return [
        name
        for name, p in section.parameters.items()
        if abs(p.value - p.nominal) > FAR_TOLERANCES * p.prior_sd
    ]


def _check_reasons(goodness: GoodnessSection) -> str:
    """What a check of the readings found."""
    ratio = noise_ratio(goodness.chi2, goodness.dof)
    if goodness.mistakes:
        return (
            f"the readings look mistaken ({goodness.mistakes[0].what}): the fit is bad"
        )
    if ratio is None or goodness.p_high is None or goodness.p_high >= ALARM_PROBABILITY:
        return "the readings fail their check: the fit is bad"
    return _large(ratio)


def _residual_reasons(
    goodness: GoodnessSection | None, estimate: EstimateSection
) -> list[str]:
    """Residuals of readings that no check looked at: those of a virtual machine."""
    chi2, dof = estimate.chi2, estimate.dof
    is_large = chi2_is_large(chi2, dof)
    if goodness is not None and goodness.chi2 is not None and goodness.dof is not None:
        chi2, dof = goodness.chi2, goodness.dof
        is_large = goodness.p_high is not None and goodness.p_high < ALARM_PROBABILITY
    is_estimated = goodness is not None and (
        bool(goodness.noise) or (goodness.law_p_high or 0.0) >= ALARM_PROBABILITY
    )
    ratio = noise_ratio(chi2, dof)
    if ratio is None or not is_large or (is_estimated and ratio <= GUESS_RATIO):
        return []
    return [_large(ratio)]


def _large(ratio: float) -> str:
    return f"the residuals are {ratio:.1f} times the stated noise: the fit is bad"
