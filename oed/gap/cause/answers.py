"""Answers of a diagnosis: hypotheses grouped by classes, the 95 % set, the verdict.

An answer is what a person should read: what acts with a named effect and could be any
of many is reported as unknown there. A gap of a size that no reading shows is no reason
to report one, but it is a gap: it counts with the answers, not with no gap. The 95 %
set is what should hold the truth: it has such names with all members of their classes,
and counts a set of named effects once, with or without a remainder.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from oed.base import Array
from oed.effect_model import Effect
from oed.gap.cause.compare import equivalent_effects
from oed.gap.cause.search import UNSEEN_SHARE, Hypothesis, Search
from oed.gap.data.diagnosis import AGAIN, ExcessScatter, Verdict
from oed.gap.data.problem import LACKING, covariate
from oed.result import UNKNOWN, AnswerRecord, GapSection, probability_of
from oed.text import join_words

# Advice: the physical remedy, or the reading that distinguishes the members of a class.

#: probability of noise alone from which a gap is read again before anything else
REPEAT_PROBABILITY = 0.1


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
    by_name = {e.name: e for e in effects}
    first = answers[0]
    if scatter is not None:
        return (_scatter_advice(scatter),)
    sentences = _no_effect_advice(answers, unstated)
    if first.effects:
        sentences = _answer_advice(answers, by_name)
    if not is_sure(answers):
        rivals = [answer for answer in answers[1:] if answer.visible > 0.0]
        sentences = _add_rivals(sentences, first, rivals, by_name)
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


def _add_rivals(
    sentences: Sequence[str],
    first: AnswerRecord,
    rivals: Sequence[AnswerRecord],
    by_name: Mapping[str, Effect],
) -> list[str]:
    """What decides comes before a remedy, which may be for another effect."""
    rival = max(rivals, key=lambda answer: answer.visible)
    tests = _distinction(first, rival, by_name)
    if not first.effects:
        return [*sentences, *tests]
    noise = [a for a in rivals if not a.effects and a.visible >= REPEAT_PROBABILITY]
    repeats = [
        text for answer in noise for text in _distinction(first, answer, by_name)
    ]
    beside = []
    if set(rival.effects) == {*first.effects, UNKNOWN}:
        beside = [
            "Something of unknown form may act beside it: read again after a remedy."
        ]
    return [*repeats, *tests, *sentences, *beside]


def is_sure(answers: Sequence[AnswerRecord]) -> bool:
    """Whether the leading answer is sure, or no other has a size that shows."""
    first, *others = answers
    unseen = 0.0 if first.effects else sum(answer.unseen for answer in answers)
    is_alone = not any(answer.visible > 0.0 for answer in others)
    return is_alone or first.probability + unseen >= GapSection.SURE_PROBABILITY


def _missing_covariates(not_testable: Mapping[str, str]) -> list[str]:
    missing = set()
    for reason in not_testable.values():
        if reason.startswith(LACKING):
            needs = reason.removeprefix(LACKING).split(", ")
            missing |= {covariate(need) for need in needs}
    return sorted(missing)


def _answer_advice(
    answers: Sequence[AnswerRecord], by_name: Mapping[str, Effect]
) -> list[str]:
    """Remedies or tests of the leading answer, those of what is sure first."""
    answer = answers[0]
    sentences, unsure = [], []
    named = [e for e in answer.effects if e != UNKNOWN]
    for effect, members in zip(named, answer.classes, strict=True):
        if len(members) > 1:
            sentences.append(_class_advice(members, by_name))
        elif by_name[effect].remedy:
            remedy = f"{effect}: {by_name[effect].remedy}."
            if probability_of(effect, answers) >= GapSection.SURE_PROBABILITY:
                sentences.append(remedy)
            else:
                unsure.append(f"If it is {remedy}")
    if answer.effects == (UNKNOWN,):
        is_sure_of_it = probability_of(UNKNOWN, answers) >= GapSection.SURE_PROBABILITY
        acts = "acts" if is_sure_of_it else "may act"
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


def _scatter_advice(scatter: ExcessScatter) -> str:
    """The reading that decides what readings beyond their instrument are."""
    if scatter.against == GapSection.DATA_SHEET:
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


def _no_effect_advice(
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
    if visible <= GapSection.DOUBT_PROBABILITY:
        return [GapSection.GO_AHEAD]
    return [
        GapSection.GO_AHEAD,
        f"An effect is not excluded (probability {100.0 * visible:.0f} %): one run taken"
        " again, and once in the other direction, would show it. What recurs at its poses"
        " beyond the noise is an effect; what does not is noise, or changes with time.",
    ]


MAX_TESTS = 3  #: tests that are named where many effects look alike


def _class_advice(members: Sequence[str], by_name: Mapping[str, Effect]) -> str:
    """What would distinguish the members of a class, those of a large one unnamed."""
    if len(members) > GapSection.MAX_CLASS_NAMES:
        tests = list(dict.fromkeys(_tests(members, by_name)))[:MAX_TESTS]
        return (
            f"These readings cannot tell {len(members)} effects apart. What would help"
            f" first: {'; '.join(tests)}."
        )
    tests = []
    for member in members:
        exposed_by = by_name[member].exposed_by
        if exposed_by:
            tests.append(f"{exposed_by} would show {member}")
    names = join_words(members)
    return f"These readings cannot tell {names} apart: " + "; ".join(tests) + "."


def _distinction(
    first: AnswerRecord, second: AnswerRecord, by_name: Mapping[str, Effect]
) -> list[str]:
    """What would distinguish the leading answer from the second."""
    if not second.effects:
        tests = _tests(first.effects, by_name)
        shown = [effect for effect in first.effects if _tests([effect], by_name)]
        more = ""
        if tests:
            more = f" What would show {join_words(shown)}: {join_words(tests)}."
        chance = f"{100.0 * second.probability:.0f} %"
        return [
            f"Noise alone has a probability of {chance}: read again before you"
            f" correct anything.{more}"
        ]
    many = {
        names[0] for names in second.classes if len(names) > GapSection.MAX_CLASS_NAMES
    }
    others = [e for e in second.effects if e not in first.effects and e not in many]
    sentences = []
    for effect in others:
        for test in _tests([effect], by_name):
            sentences.append(f"To make sure that it is not {effect}: {test}.")
    return sentences


def _tests(effects: Sequence[str], by_name: Mapping[str, Effect]) -> list[str]:
    tests = [by_name[effect].exposed_by for effect in effects if effect in by_name]
    return [test for test in tests if test]


MIN_REPORTED = 0.002  #: least probability of an answer that is reported
#: log posterior by which a rival may be behind and still belong to an effect's class
RIVAL_LOG_POSTERIOR = 5.5
#: members from which on a class with a named effect is reported as unknown
MIN_VAGUE_MEMBERS = 6

#: for each effect the names that are indistinguishable from it
Classes = Sequence[tuple[str, ...]]


@dataclasses.dataclass(frozen=True, slots=True)
class AnswerGroup:
    """Hypotheses that one stands for."""

    hypothesis: Hypothesis  #: the best of them
    members: tuple[tuple[str, ...], ...]  #: a class for each of its effects
    unknown: bool  #: whether an unknown remainder acts as well
    probability: float  #: of all of them together
    unseen: float = 0.0  #: part of it at sizes that no reading shows: all or nothing


def group(
    searches: Sequence[Search], hypotheses: Sequence[Hypothesis], shares: Array
) -> list[AnswerGroup]:
    """Hypotheses of probability `shares`, best first, each with those it stands for."""
    remaining = dict(zip([h.key for h in hypotheses], shares, strict=True))
    scores = {h.key: h.score for h in hypotheses}
    groups: list[AnswerGroup] = []
    unseen: list[AnswerGroup] = []
    for h in hypotheses:
        if h.key not in remaining:
            continue
        if groups and remaining[h.key] < MIN_REPORTED:
            continue
        members = tuple(
            equivalent_effects(searches[h.law], h, scores, RIVAL_LOG_POSTERIOR)
        )
        total = 0.0
        for key in list(remaining):
            effects, unknown = key
            if unknown == h.unknown and _stands_for(effects, members):
                total += remaining.pop(key)
        if not h.is_gap:  # of what no reading shows they say nothing: its prior share
            hidden = float(total) * UNSEEN_SHARE
            unseen.append(AnswerGroup(h, (), True, hidden, hidden))
            total -= hidden
        groups.append(AnswerGroup(h, members, h.unknown, float(total)))
    return [*groups, *unseen]


def rank(
    groups: Sequence[AnswerGroup],
) -> tuple[tuple[AnswerRecord, ...], tuple[Hypothesis, ...]]:
    """The decision first, then the other answers by probability.

    A gap is reported where one of a size that shows is probable enough. The second
    result is the best hypothesis of each answer.
    """
    answers: list[AnswerRecord] = []
    leading: list[Hypothesis] = []
    for entry in groups:
        _add(answers, entry)
        leading += [entry.hypothesis] * (len(answers) - len(leading))
    decision = _decision(answers)
    order = sorted(range(len(answers)), key=lambda k: -answers[k].probability)
    order.remove(decision)
    ranked = [decision, *order]
    return tuple(answers[k] for k in ranked), tuple(leading[k] for k in ranked)


def _add(answers: list[AnswerRecord], entry: AnswerGroup) -> None:
    """Add an answer, or its probability to the one that says the same.

    What acts with a named effect and may be any of many is reported as unknown: a name
    drawn from them would be a guess.
    """
    named = list(entry.members)
    if len(named) > 1:
        clear = [m for m in named if len(m) < MIN_VAGUE_MEMBERS]
        named = clear or [min(named, key=len)]
    unknown = entry.unknown or len(named) < len(entry.members)
    names = frozenset(members[0] for members in named)
    for k, other in enumerate(answers):
        alike = (UNKNOWN in other.effects) == unknown and not entry.unseen
        if alike and _stands_for(names, other.classes):
            probability = other.probability + entry.probability
            answers[k] = replace(other, probability=probability)
            return
    answers.append(_answer(named, unknown, entry.probability, entry.unseen))


def _decision(answers: Sequence[AnswerRecord]) -> int:
    """Number of the answer that costs least by the loss table."""
    gaps = [k for k, answer in enumerate(answers) if answer.effects]
    nothing = [k for k, answer in enumerate(answers) if not answer.effects]
    if not gaps or not nothing:
        return max(range(len(answers)), key=lambda k: answers[k].visible)
    likeliest = max(gaps, key=lambda k: answers[k].visible)
    gap = sum(answers[k].visible for k in gaps)
    total = sum(answer.probability for answer in answers)
    return likeliest if GapSection.MISSED_GAP_COST * gap > total - gap else nothing[0]


def _answer(
    members: Classes, unknown: bool, probability: float, unseen: float = 0.0
) -> AnswerRecord:
    names = tuple(m[0] for m in members)
    effects = (*names, UNKNOWN) if unknown else names
    return AnswerRecord(effects, probability, tuple(members), unseen)


def _stands_for(effects: frozenset[str], members: Classes) -> bool:
    """Whether a set of effects takes exactly one member of each class."""
    if len(effects) != len(members):
        return False
    if not members:
        return True
    return any(
        _stands_for(effects - {name}, members[1:])
        for name in members[0]
        if name in effects
    )


def credible_set(groups: Sequence[AnswerGroup]) -> tuple[AnswerRecord, ...]:
    """The fewest sets of named effects that together have 95 %, by probability.

    An unknown remainder joins them where it has most of their probability.
    """
    sets: list[list[AnswerGroup]] = []
    for entry in sorted(groups, key=lambda g: (g.unseen > 0.0, -g.probability)):
        names = frozenset(members[0] for members in entry.members)
        for alike in sets:
            # no gap and an unknown alone differ
            is_same = bool(names) or entry.unknown == alike[0].unknown
            is_same = is_same and not entry.unseen
            if is_same and _stands_for(names, alike[0].members):
                alike.append(entry)
                break
        else:
            sets.append([entry])
    answers = []
    for alike in sets:
        total = sum(g.probability for g in alike)
        unknown = sum(g.probability for g in alike if g.unknown) > 0.5 * total
        unseen = sum(g.unseen for g in alike)
        answers.append(_answer(alike[0].members, unknown, total, unseen))
    answers.sort(key=lambda a: -a.probability)
    reached = np.cumsum([a.probability for a in answers]) >= 0.95
    return tuple(answers[: int(np.argmax(reached)) + 1 if reached.any() else None])


def verdict(answer: AnswerRecord) -> Verdict:
    """The kind of an answer."""
    if not answer.effects:
        return "none"
    if answer.effects == (UNKNOWN,):
        return "unknown"
    if UNKNOWN in answer.effects:
        return "mixture"
    if any(len(c) > 1 for c in answer.classes):
        return "class"
    return "effect" if len(answer.effects) == 1 else "mixture"
