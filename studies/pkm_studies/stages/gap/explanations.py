"""Explanations of a gap beside the best one: how probable they are, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from oed.gap.cause.advice import MOST_NAMES
from oed.gap.data.diagnosis import UNKNOWN
from oed.result.gap import AnswerRecord, GapSection
from pkm_studies.stages.gap.words import (
    capitalised,
    format_probability,
    join_words,
    plain_name,
)

#: probability from which a second explanation is named
CONSIDERABLE = 0.1


def probability_of_causes(gap: GapSection) -> float:
    """That the best answer's named effects act, alone or beside one of unknown form."""
    same = [answer for answer in gap.answers if has_its_causes(answer, gap)]
    return sum(answer.visible for answer in same)


def has_its_causes(answer: AnswerRecord, gap: GapSection) -> bool:
    """Whether an answer differs from the best one by an unknown remainder at most."""
    best = gap.answers[0]
    if answer is best:
        return True
    names, others = ({*a.effects} - {UNKNOWN} for a in (best, answer))
    return bool(names) and names == others and answer.visible > 0.0


def chance_of(probability: float) -> str:
    """A probability, to stand behind what has it."""
    return f" (probability {format_probability(probability)})"


def second_explanation(gap: GapSection) -> list[str]:
    """The next explanation, where its probability is considerable."""
    if len(gap.answers) < 2:
        return []
    best, *rest = gap.answers
    words = [
        f"An effect of unknown form may act beside it{chance_of(answer.visible)}."
        for answer in rest
        if has_its_causes(answer, gap)
        and UNKNOWN in answer.effects
        and answer.visible >= CONSIDERABLE
    ]
    others = [answer for answer in rest if not has_its_causes(answer, gap)]
    if gap.verdict == UNKNOWN:
        # the first sentence counts all answers with something of unknown form
        words += _beside_unknown(others)
        others = [answer for answer in others if UNKNOWN not in answer.effects]
    second = max(others, key=lambda answer: answer.visible, default=best)
    if second is best or second.visible < CONSIDERABLE:
        return words
    if not second.effects and second.probability > probability_of_causes(gap):
        return [*words, "Noise alone is more likely, but not enough to report no gap."]
    causes, chance = _spoken(second) or "no gap at all", chance_of(second.visible)
    if gap.verdict == "none" and second.visible > best.probability:
        words.append(
            f"More likely than noise alone is {causes}{chance}, but not than noise and what"
            " is too small to be seen together."
        )
        return words
    return [*words, f"The next most likely explanation is {causes}{chance}."]


def _beside_unknown(answers: Sequence[AnswerRecord]) -> list[str]:
    """Effects that may act beside one of unknown form."""
    words = []
    for answer in answers:
        if UNKNOWN in answer.effects and answer.visible >= CONSIDERABLE:
            names = tuple(name for name in answer.effects if name != UNKNOWN)
            causes = _spoken(msgspec.structs.replace(answer, effects=names))
            chance = chance_of(answer.visible)
            words.append(f"{capitalised(causes)} may act beside it{chance}.")
    return words


def _spoken(answer: AnswerRecord) -> str:
    """An answer's effects, with those that cannot be told from them, or their number."""
    classes = {names[0]: names for names in answer.classes}
    spoken = []
    for name in answer.effects:
        alike = classes.get(name, (name,))
        plain = join_words([plain_name(n) for n in alike], last="or")
        many = len(alike) > MOST_NAMES
        spoken.append(f"any of {len(alike)} effects" if many else plain)
    has_alternatives = any(len(alike) > 1 for alike in answer.classes)
    return ", and ".join(spoken) if has_alternatives else join_words(spoken)
