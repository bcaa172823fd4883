"""Answers of a diagnosis: hypotheses grouped by classes, the 95 % set, the verdict.

An answer is what a person should read: what acts with a named effect and could be any
of many is reported as unknown there. A gap of a size that no reading shows is no reason
to report one, but it is a gap: it counts with the answers, not with no gap. The 95 %
set is what should hold the truth: it has such names with all members of their classes,
and counts a set of named effects once, with or without a remainder.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from oed.base import Array
from oed.gap.cause.compare import equivalent_effects
from oed.gap.cause.hypothesis import PRIOR, Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import UNKNOWN, Verdict
from oed.result import AnswerRecord, GapSection

#: least probability of an answer that is reported
REPORTED = 0.002
#: log posterior by which a rival may be behind and still belong to an effect's class
ALIVE = 5.5
#: members from which on a class with a named effect is reported as unknown
VAGUE = 6
#: probability that the credible set has
COVERAGE = 0.95

#: for each effect the names that are indistinguishable from it
Classes = Sequence[tuple[str, ...]]


@dataclasses.dataclass(frozen=True, slots=True)
class AnswerGroup:
    """Hypotheses that one stands for.

    hypothesis     the best of them
    members        a class for each of its effects
    unknown        whether an unknown remainder acts as well
    probability    of all of them together
    unseen         part of it at sizes that no reading shows
    """

    hypothesis: Hypothesis
    members: tuple[tuple[str, ...], ...]
    unknown: bool
    probability: float
    unseen: float = 0.0

    @property
    def is_any_effect(self) -> bool:
        """Whether it is any effect too small to be seen, which no other group joins."""
        return self.unseen > 0.0 and bool(self.members)


def group(
    searches: Sequence[Search],
    hypotheses: Sequence[Hypothesis],
    shares: Array,
) -> list[AnswerGroup]:
    """Hypotheses, best first, each with those that it stands for.

    `shares` are their probabilities.
    """
    remaining = dict(zip([h.key for h in hypotheses], shares, strict=True))
    scores = {h.key: h.score for h in hypotheses}
    groups: list[AnswerGroup] = []
    unseen: list[AnswerGroup] = []
    for h in hypotheses:
        if h.key not in remaining:
            continue
        if groups and remaining[h.key] < REPORTED:
            continue
        members: tuple[tuple[str, ...], ...] = ()
        if h.effects:
            members = tuple(equivalent_effects(searches[h.law], h, scores, ALIVE))
        total = 0.0
        for key in list(remaining):
            effects, unknown = key
            if unknown == h.unknown and _stands_for(effects, members):
                total += remaining.pop(key)
        entry = AnswerGroup(h, members, h.unknown, float(total))
        if not h.is_gap:
            entry, *unseen = _without_a_sign(entry, searches[h.law].library.effects)
        groups.append(entry)
    return [*groups, *unseen]


def _without_a_sign(nothing: AnswerGroup, names: tuple[str, ...]) -> list[AnswerGroup]:
    """What may act where nothing shows: nothing, any effect, something unknown.

    The readings say nothing of these three, so that they keep their prior shares.
    """
    unseen = PRIOR["unseen"] / (PRIOR["unseen"] + PRIOR["none"])
    unknown = PRIOR["unknown"] / (1.0 - PRIOR["unseen"] - PRIOR["none"])
    if not names:
        unknown = 1.0
    total, alone = nothing.probability, nothing.hypothesis
    of_unknown, of_effects = total * unseen * unknown, total * unseen * (1.0 - unknown)
    groups = [dataclasses.replace(nothing, probability=total * (1.0 - unseen))]
    if names:
        groups.append(AnswerGroup(alone, (names,), False, of_effects, of_effects))
    groups.append(AnswerGroup(alone, (), True, of_unknown, of_unknown))
    return groups


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
        clear = [m for m in named if len(m) < VAGUE]
        named = clear or [min(named, key=len)]
    unknown = entry.unknown or len(named) < len(entry.members)
    names = frozenset(members[0] for members in named)
    for k, other in enumerate(answers):
        alike = (UNKNOWN in other.effects) == unknown and not entry.is_any_effect
        if alike and _stands_for(names, other.classes):
            probability = other.probability + entry.probability
            unseen = other.unseen + entry.unseen
            answers[k] = replace(other, probability=probability, unseen=unseen)
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
            is_same = is_same and not entry.is_any_effect
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
    reached = np.cumsum([a.probability for a in answers]) >= COVERAGE
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
