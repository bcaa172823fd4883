"""Reports the estimated noise law: `noise` of the section `goodness`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from oed import units
from oed.estimation import Estimate, noise_numbers
from oed.fit_limits import ALARM_PROBABILITY, noise_ratio
from oed.instrument import Setup
from oed.noise import reach_phrase
from oed.result import GoodnessSection, NoiseRecord
from oed.text import rounded


def with_noise(
    section: GoodnessSection, estimate: Estimate, setups: Mapping[str, Setup]
) -> GoodnessSection:
    """The section with the noise law of an estimate, where it has one."""
    posterior = estimate.noise_posterior
    if posterior is None:
        return section
    numbers = noise_numbers(posterior, setups)
    records = {f"{n.kind} {n.of}".rstrip(): n for n in numbers}
    assumed = posterior.prior.statement.is_assumed
    stated_as = "assumed" if assumed else "stated"
    phrase = _words(numbers, stated_as, posterior.structure.longest)
    return msgspec.structs.replace(section, noise=records, noise_words=phrase)


def add_assumption(
    section: GoodnessSection,
    estimate: Estimate,
    setups: Mapping[str, Setup],
    count: int,
) -> GoodnessSection:
    """The section with a finding that the noise is assumed, where nothing tests it.

    setups  of the readings
    count   of the readings
    """
    if section.noise:
        return section
    amounts = []
    for setup in setups.values():
        for channel, sigma in zip(setup.instrument.channels, setup.sigma, strict=True):
            unit = units.FINE[channel.unit]
            amounts.append(f"{channel.name} {units.number(sigma, unit):.3g} {unit}")
    freedom = max(estimate.dof, 0.0)
    verdict = "which these readings cannot test"
    ratio = noise_ratio(section.chi2, section.dof)
    is_small = section.p_low is not None and section.p_low < ALARM_PROBABILITY
    if is_small and ratio is not None:
        verdict = f"and too large: the residuals are {rounded(ratio)} times it"
    sentence = (
        f"The noise of the readings ({', '.join(dict.fromkeys(amounts))}) is an"
        f" assumption, {verdict} ({count} readings, {freedom:.1f} degrees of freedom). All"
        " intervals scale with it: measure it by probing one place several times, and"
        " give it in [noise]."
    )
    return msgspec.structs.replace(section, findings=[*section.findings, sentence])


#: kinds that are standard deviations, and what they are
_ERRORS = {
    "reading": "single readings of {} scatter by",
    "run": "the readings of one run of {} share an error of",
    "seat": "what each run of {} seats anew moves by",
    "course": "through the session the readings of {} share a course that ends off by",
}


def _words(numbers: Sequence[NoiseRecord], stated_as: str, longest: int) -> list[str]:
    """Departures from the stated noise, as one sentence; none where there is none.

    stated_as  stated, or assumed
    longest    number of readings of the longest run
    """
    reach = [n.value for n in numbers if n.kind == "reach"]
    phrases = []
    for number in numbers:
        if not number.departs:
            continue
        size = f"{rounded(number.value)} ± {rounded(number.sd, 1)}"
        of = f" of {number.of}" if number.of else ""
        if number.kind == "carried":
            phrases.append(
                f"a share of {size} of the variance of single readings{of} is carried"
                f" along a run, {reach_phrase(reach[0], longest)}"
            )
            continue
        stated = (
            f" ({stated_as}: {number.stated:.3g} {number.unit})"
            if number.stated
            else ""
        )
        start = _ERRORS[number.kind].format(number.of)
        phrases.append(f"{start} {size} {number.unit}{stated}")
    if not phrases:
        return []
    return [f"The noise departs from the {stated_as} one: {'; '.join(phrases)}."]
