"""Hypotheses gathered into answers: which effects act, each with those that cannot be
told from it; none first only where it is sure; and the 95 % set.

An answer is what a person should be told: what acts beside a named effect and could be
any of many is told as unknown there. The 95 % set is what should hold the truth: it
keeps such names with all members of their classes, and counts a set of named effects
once, whatever remainder is beside them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from oed.arrays import Array
from oed.gap.cause import classes
from oed.gap.cause.which import Hypothesis, Search
from oed.gap.data.diagnosis import UNKNOWN, Answer, Verdict

#: answers are told down to this probability
TOLD = 0.002
#: log posterior by which a rival may be behind and still belong to an effect's class
ALIVE = 5.5
#: probability from which on no gap is told: one that is missed costs more than one that
#: is looked for in vain; and where what could be looked for is any of many
SURE, EVEN = 0.65, 0.5
#: members from which on a class beside a named effect is told as unknown
VAGUE = 6
#: probability that the set of answers holds together
HELD = 0.95


@dataclasses.dataclass(frozen=True, slots=True)
class AnswerGroup:
    """Hypotheses that one stands for: a class for each of its effects, whether an
    unknown is beside them.
    """

    hypothesis: Hypothesis
    members: tuple[tuple[str, ...], ...]
    unknown: bool
    probability: float


def gathered(
    made: Sequence[Search], hypotheses: Sequence[Hypothesis], shares: Array
) -> list[AnswerGroup]:
    """Hypotheses, best first, with their probabilities: one that stands for another is
    counted with it.
    """
    left = dict(zip([h.key for h in hypotheses], shares, strict=True))
    scores = {h.key: h.score for h in hypotheses}
    groups: list[AnswerGroup] = []
    for h in hypotheses:
        if h.key not in left or (left[h.key] < TOLD and groups):
            continue
        members = tuple(classes.of(made[h.law], h, scores, ALIVE)) if h.effects else ()
        total = 0.0
        for key in list(left):
            if key[1] == h.unknown and _stands_for(key[0], members):
                total += left.pop(key)
        groups.append(AnswerGroup(h, members, h.unknown, float(total)))
    return groups


def told(groups: Sequence[AnswerGroup]) -> tuple[tuple[Answer, ...], Hypothesis]:
    """Answers by probability, none first only where it is sure; and the best hypothesis
    of the first answer.
    """
    answers: list[Answer] = []
    leading: list[Hypothesis] = []
    for group in groups:
        _tell(answers, group.members, group.unknown, group.probability)
        leading += [group.hypothesis] * (len(answers) - len(leading))
    order = sorted(range(len(answers)), key=lambda k: -answers[k].probability)
    if len(order) > 1 and not answers[order[0]].effects:
        next_best = answers[order[1]]
        vague = next_best.effects == (UNKNOWN,) or any(
            len(c) >= VAGUE for c in next_best.classes
        )
        if answers[order[0]].probability < (EVEN if vague else SURE):
            order[:2] = order[1::-1]
    return tuple(answers[k] for k in order), leading[order[0]]


def _tell(
    answers: list[Answer],
    members: Sequence[tuple[str, ...]],
    unknown: bool,
    probability: float,
) -> None:
    """Add an answer, or its probability to the one that says the same.

    What acts beside a named effect and may be any of many is told as unknown: a name
    drawn from them would be a guess.
    """
    told = list(members)
    if len(members) > 1:
        told = [m for m in members if len(m) < VAGUE] or [min(members, key=len)]
    unknown = unknown or len(told) < len(members)
    names = tuple(m[0] for m in told)
    for k, a in enumerate(answers):
        if (UNKNOWN in a.effects) == unknown and _stands_for(
            frozenset(names), a.classes
        ):
            answers[k] = dataclasses.replace(a, probability=a.probability + probability)
            return
    answers.append(_answer(told, unknown, probability))


def _answer(
    members: Sequence[tuple[str, ...]], unknown: bool, probability: float
) -> Answer:
    names = tuple(m[0] for m in members)
    return Answer((*names, UNKNOWN) if unknown else names, probability, tuple(members))


def _stands_for(effects: frozenset[str], members: Sequence[tuple[str, ...]]) -> bool:
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


def held(groups: Sequence[AnswerGroup]) -> tuple[Answer, ...]:
    """The fewest sets of named effects that together have 95 %, by probability; an
    unknown remainder is told beside them where it has most of theirs.
    """
    sets: list[list[AnswerGroup]] = []
    for group in sorted(groups, key=lambda g: -g.probability):
        names = frozenset(m[0] for m in group.members)
        same = (s for s in sets if names and _stands_for(names, s[0].members))
        alike = next(same, None)
        if alike is None:
            sets.append([group])
        else:
            alike.append(group)
    answers = []
    for alike in sets:
        total, beside = (
            sum(g.probability for g in alike),
            sum(g.probability for g in alike if g.unknown),
        )
        answers.append(_answer(alike[0].members, beside > 0.5 * total, total))
    answers.sort(key=lambda a: -a.probability)
    total, kept = 0.0, []
    for answer in answers:
        kept.append(answer)
        total += answer.probability
        if total >= HELD:
            break
    return tuple(kept)


def verdict(answer: Answer) -> Verdict:
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
