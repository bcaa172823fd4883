"""Advice: the physical remedy, or the reading that distinguishes the members of a class."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from oed.effect_model import Effect
from oed.gap.data.diagnosis import AGAIN, DATA_SHEET, UNKNOWN, ExcessScatter
from oed.gap.data.signature import LACKS
from oed.result import AnswerRecord
from oed.text import join_words

#: probability of the leading answer below which the advice considers its rival too
SURE = 0.8
#: probability of visible effects from which the advice says how to show one
DOUBT = 0.05
#: what to do where no effect is reported
GO_AHEAD = "Nothing beyond the geometry and the noise is seen: compensate the geometry."
#: probability of noise alone from which a gap is read again before anything else
WORTH_A_REPEAT = 0.1
#: members of a class that are named each
MOST_NAMES = 4


def advise(
    answers: Sequence[AnswerRecord],
    effects: Sequence[Effect],
    not_testable: Mapping[str, str],
    *,
    scatter: ExcessScatter | None = None,
    unstated: float | None = None,
) -> tuple[str, ...]:
    """Sentences, the most useful first, for the leading answer.

    Where it is not sure, they also consider its likeliest rival.

    scatter   of readings beyond their instrument, which nothing explains
    unstated  scatter of a reading over the stated one, where it is beyond a data sheet
    """
    known = {e.name: e for e in effects}
    first = answers[0]
    if scatter is not None:
        return (_for_scatter(scatter),)
    sentences = (
        _for_answer(answers, known)
        if first.effects
        else _without_effect(answers, unstated)
    )
    if not is_sure(answers):
        rivals = [answer for answer in answers[1:] if answer.visible > 0.0]
        sentences = _with_rivals(sentences, first, rivals, known)
    missing = _missing_covariates(not_testable)
    if missing and not first.effects:
        sentences.append(
            "These readings cannot test all effects. Record with the next ones, and"
            f" vary: {join_words(missing)}."
        )
    elif missing and UNKNOWN in first.effects:
        sentences.append(
            "What acts may be what these readings cannot test: record and vary"
            f" {join_words(missing)}."
        )
    return tuple(dict.fromkeys(sentences))


def _with_rivals(
    sentences: Sequence[str],
    first: AnswerRecord,
    rivals: Sequence[AnswerRecord],
    known: Mapping[str, Effect],
) -> list[str]:
    """What decides comes before a remedy, which may be for another effect."""
    rival = max(rivals, key=lambda answer: answer.visible)
    tests = _between(first, rival, known)
    if not first.effects:
        return [*sentences, *tests]
    noise = [a for a in rivals if not a.effects and a.visible >= WORTH_A_REPEAT]
    repeats = [text for answer in noise for text in _between(first, answer, known)]
    beside = []
    if set(rival.effects) == {*first.effects, UNKNOWN}:
        beside = [
            "Something of unknown form may act beside it: read again after a remedy."
        ]
    return [*repeats, *tests, *sentences, *beside]


def is_sure(answers: Sequence[AnswerRecord]) -> bool:
    """Whether the leading answer is sure, or no other has a size that shows.

    No gap is no less sure for what is too small to be seen.
    """
    first, *others = answers
    unseen = 0.0 if first.effects else sum(answer.unseen for answer in answers)
    is_alone = not any(answer.visible > 0.0 for answer in others)
    return is_alone or first.probability + unseen >= SURE


def _missing_covariates(not_testable: Mapping[str, str]) -> list[str]:
    """The covariates without which effects could not be tested."""
    missing = set()
    for reason in not_testable.values():
        if reason.startswith(LACKS):
            needs = reason.removeprefix(LACKS).split(", ")
            missing |= {re.split(r":| or ", need)[0] for need in needs}
    return sorted(missing)


def _for_answer(
    answers: Sequence[AnswerRecord], known: Mapping[str, Effect]
) -> list[str]:
    """Remedies or tests of the leading answer, those of what is sure first."""
    answer = answers[0]
    sentences, unsure = [], []
    named = [e for e in answer.effects if e != UNKNOWN]
    for effect, members in zip(named, answer.classes, strict=True):
        if len(members) > 1:
            sentences.append(_for_class(members, known))
        elif known[effect].remedy:
            remedy = f"{effect}: {known[effect].remedy}."
            if probability_of(effect, answers) >= SURE:
                sentences.append(remedy)
            else:
                unsure.append(f"If it is {remedy}")
    if answer.effects == (UNKNOWN,):
        acts = "acts" if probability_of(UNKNOWN, answers) >= SURE else "may act"
        sentences.append(
            f"Something {acts} that no effect of the library explains: look at where it"
            " lies, vary one condition at a time (direction, feed, payload, time) on"
            " the runs that show it, and add an effect of your own."
        )
    elif UNKNOWN in answer.effects:
        sentences.append(
            "A remainder of unknown shape is left: look at its trace, and at where it"
            " lies, before acting on it."
        )
    return [*sentences, *unsure]


def _for_scatter(scatter: ExcessScatter) -> str:
    """The reading that decides what readings beyond their instrument are."""
    if scatter.against == DATA_SHEET:
        return (
            "Do not compensate yet: read some poses several times without moving. What"
            " scatters there is noise, and the instrument is worse than stated. What"
            " repeats there is not: take the same run again, then in the other direction."
        )
    if scatter.against == AGAIN:
        return (
            "Do not compensate yet: what recurs in runs taken again is no noise. Take one"
            " of them in the other direction, and one with half the step: they show its"
            " form."
        )
    return (
        "Do not compensate yet: take the same run again. What recurs at its poses is an"
        " effect: take it in the other direction then. What does not is how well the"
        " machine repeats, which no compensation improves."
    )


def _without_effect(
    answers: Sequence[AnswerRecord], unstated: float | None
) -> list[str]:
    """What to do where no effect is reported: act, and what would show more."""
    if unstated is not None:
        return [
            f"A reading scatters {unstated:.2g} times as much as stated, with what its run"
            " shares: take one run twice in a row before you compensate the geometry. What"
            " changes between the two is noise, to be stated in [noise]; what changes over"
            " the session alone is an effect."
        ]
    visible = sum(answer.visible for answer in answers if answer.effects)
    if visible <= DOUBT:
        return [GO_AHEAD]
    return [
        GO_AHEAD,
        f"An effect is not excluded (probability {100.0 * visible:.0f} %): one run taken"
        " again, and once in the other direction, would show it. What recurs at its poses"
        " beyond the noise is an effect; what does not is noise, or changes with time.",
    ]


def probability_of(effect: str, answers: Sequence[AnswerRecord]) -> float:
    """That an effect acts, whatever is beside it."""
    return sum(answer.visible for answer in answers if effect in answer.effects)


def _for_class(members: Sequence[str], known: Mapping[str, Effect]) -> str:
    """What would distinguish the members of a class, those of a large one unnamed."""
    if len(members) > MOST_NAMES:
        tests = list(dict.fromkeys(_tests(members, known)))
        return (
            f"These readings cannot tell {len(members)} effects apart. What would:"
            f" {'; '.join(tests)}."
        )
    tests = []
    for member in members:
        exposed_by = known[member].exposed_by
        if exposed_by:
            tests.append(f"{exposed_by} would show {member}")
    names = join_words(members)
    return f"These readings cannot tell {names} apart: " + "; ".join(tests) + "."


def _between(
    first: AnswerRecord,
    second: AnswerRecord,
    known: Mapping[str, Effect],
) -> list[str]:
    """What would distinguish the leading answer from the second."""
    if not second.effects:
        tests = _tests(first.effects, known)
        shown = [effect for effect in first.effects if _tests([effect], known)]
        more = (
            f" What would show {join_words(shown)}: {join_words(tests)}."
            if tests
            else ""
        )
        chance = f"{100.0 * second.probability:.0f} %"
        return [
            f"Noise alone has a probability of {chance}: read again before acting on"
            f" the gap.{more}"
        ]
    many = {names[0] for names in second.classes if len(names) > MOST_NAMES}
    others = [e for e in second.effects if e not in first.effects and e not in many]
    sentences = []
    for effect in others:
        for test in _tests([effect], known):
            sentences.append(f"To make sure that it is not {effect}: {test}.")
    return sentences


def _tests(effects: Sequence[str], known: Mapping[str, Effect]) -> list[str]:
    """Measurements that expose some effects."""
    tests = [known[effect].exposed_by for effect in effects if effect in known]
    return [test for test in tests if test]
