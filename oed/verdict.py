"""The verdict on a wanted accuracy: pass, fail or cannot tell, with its probability.

What one machine's rms error over the workspace will be is known as a distribution. With P
the probability that it is at most what is wanted,

    pass  if P >= 0.95,    fail  if P <= 0.05,    cannot tell  otherwise.

P over the geometry alone is too large wherever effects act. So it can end in fail, and
never in pass. Commands, pages, reports, certificates and campaigns ask
here, and judge nothing on their own.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Final

from oed import trust
from oed.result import Judgement, StudyResult, WantedVerdict
from oed.text import format_probability

SURE_PROBABILITY: Final = 0.95  #: probability from which a pass or a fail is stated
#: what a distribution of errors holds, by the mode of its prediction
SCOPE_WORDS: Final = {
    "mixture": "averaged over the possible causes",
    "corrected": "with the effects that are corrected",
}
#: the same where the controller corrects the geometry and no effect
NOT_CORRECTED: Final = "with the effects acting, not corrected"
GEOMETRY_ALONE: Final = "geometry alone"
WITH_USUAL_EFFECTS: Final = "with usual effects at their expected sizes"


def judge(
    probability: float, sure: float = SURE_PROBABILITY, *, can_pass: bool = True
) -> Judgement:
    """The verdict of a probability that what is wanted is met.

    sure      probability from which a verdict is stated, above one half
    can_pass  False where the probability is an upper bound
    """
    if probability <= 1.0 - sure:
        return "fail"
    return "pass" if probability >= sure and can_pass else "cannot tell"


def overall(judgements: Iterable[Judgement]) -> Judgement | None:
    """One verdict of several: the worst; None of none."""
    stated = set(judgements)
    ordered: tuple[Judgement, ...] = ("fail", "cannot tell", "pass")
    return next((judgement for judgement in ordered if judgement in stated), None)


def all_pass(judgements: Iterable[Judgement]) -> bool:
    """Whether every verdict is a pass; true of none, for nothing was wanted."""
    return overall(judgements) in (None, "pass")


def accuracy_verdicts(
    result: StudyResult,
    wanted: Mapping[str, float] | None = None,
    *,
    geometry_sent: bool = False,
    added: Mapping[str, float] | None = None,
) -> dict[str, WantedVerdict]:
    """The verdict on each wanted accuracy of a result, by component.

    wanted         {component: rms error in its unit}, of components that are predicted;
                   those of [prediction] by default
    geometry_sent  whether a controller is judged that corrects the geometry alone
    added          {component: rms error in its unit} that a file adds by its tables and
                   digits: independent of the others, so that mean squares add up
    """
    section = result.judged_prediction
    mixture = None if result.gap is None else result.gap.mixture
    if geometry_sent and mixture is not None:
        section = mixture.prediction
    if section is None:
        return {}
    components, counted = section.judged_components, section.with_usual_effects
    scope = SCOPE_WORDS.get(section.mode, GEOMETRY_ALONE)
    if geometry_sent and section.mode == "corrected":
        scope = NOT_CORRECTED
    added = added or {}
    objection = _objection(result)
    verdicts = {}
    for name, limit in (section.wanted if wanted is None else wanted).items():
        spread = components[name].judged
        rms = math.hypot(spread.rms, added.get(name, 0.0))
        factor = rms / spread.rms if spread.rms > 0.0 else 1.0
        holds = WITH_USUAL_EFFECTS if name in counted else scope
        probability = spread.probability_within(limit / factor)
        doubt = objection
        if not doubt and holds == GEOMETRY_ALONE:
            doubt = "the errors are of the geometry alone"
        judgement = judge(probability, can_pass=not doubt)
        verdicts[name] = WantedVerdict(
            judgement=judgement,
            probability=probability,
            rms=rms,
            wanted=limit,
            unit=spread.unit,
            scope=holds,
            confirmed=_is_confirmed(result, name, limit),
            decide=_what_decides(judgement, probability, doubt, section.mode),
        )
    return verdicts


def sentence(name: str, verdict: WantedVerdict, rms: str, wanted: str) -> str:
    """A verdict in words; `rms` and `wanted` as numbers to be read."""
    stated: str = verdict.judgement
    if stated == "pass":
        stated = "pass, confirmed" if verdict.confirmed else "pass, predicted"
    return (
        f"{name} {rms} of {wanted} {verdict.unit}, {stated}"
        f" (probability {format_probability(verdict.probability)})"
    )


def _objection(result: StudyResult) -> str:
    """Why no component can pass; empty where nothing speaks against it."""
    objections = trust.objections(result)
    if objections:
        return objections[0]
    if any(section.verdict == "contradicts" for section in result.held_out):
        return "held-out readings contradict the fit"
    if result.verification is not None and result.verification.judgement == "fail":
        return "the acceptance test failed"
    return ""


def _is_confirmed(result: StudyResult, name: str, wanted: float) -> bool:
    """Whether readings that no fit used confirm the prediction."""
    test = result.verification
    if test is not None and name in test.components:
        component = test.components[name]
        return component.judgement == "pass" and component.promised <= wanted
    verdicts = {section.verdict for section in result.held_out}
    return "confirms" in verdicts and "contradicts" not in verdicts


def _what_decides(
    judgement: Judgement, probability: float, doubt: str, mode: str
) -> str:
    if judgement != "cannot tell":
        return ""
    if doubt:
        return doubt
    if mode == "plan":
        return "more readings, or smaller effects: see `oed plan`"
    if probability < 0.5:
        return "further readings, or the causes that the diagnosis names"
    return "further readings: `oed next` names the best ones"
