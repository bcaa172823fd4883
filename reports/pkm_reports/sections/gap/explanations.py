"""Explanations of the gap with their probabilities, and the sizes of the effects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from oed.result import AnswerRecord, GapSection
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.sections.figures.gap import effects
from pkm_reports.sections.figures.gap.effects import spoken

MOST_ANSWERS: Final = 6
#: members from which a class is counted, not represented by one of its names
MANY: Final = 6
#: share of an explanation's probability from which it is said to be too small to be seen
MUCH: Final = 0.1
#: what the probability of one effect is of
MARGINALS: Final = (
    "Sizes that these readings cannot show do not count; effects that look alike are"
    " counted one by one."
)
#: rms, in the unit of its channel, from which an effect shows in a channel
VISIBLE: Final = 1e-9


def blocks(gap: GapSection) -> list[Block]:
    """Explanations, the credible set, sizes of the effects."""
    content = answers(gap)
    if gap.answers and len(gap.set95) > 1:
        content.append(_credible_set(gap))
    if gap.sizes:
        content.append(_sizes(gap))
    return content


def answers(gap: GapSection) -> list[Block]:
    """The explanations with their probabilities."""
    return [_answers(gap)] if gap.answers else []


def probabilities_caption(gap: GapSection) -> str:
    """How many effects could be tested, and which are not shown."""
    sentences = [
        "Probability that each effect acts in these readings, after calibration"
        f" explained what it can. {MARGINALS}",
        f"{len(gap.tried) - len(gap.not_testable)} of"
        f" {text.count(len(gap.tried), 'effect')} could be tested.",
    ]
    classes = gap.answers[0].classes if gap.answers else []
    if any(len(group) > 1 for group in classes):
        sentences.append(
            "Those in light blue cannot be distinguished from those in blue."
        )
    more = len(gap.marginal) - len(effects.shown(gap))
    if more > 0:
        sentences.append(f"The {more} least probable are not shown.")
    return " ".join(sentences)


# -- answers ---------------------------------------------------------------------------


def _columns() -> list[TableColumn]:
    return [
        wide_column("Explanation"),
        TableColumn("Probability", number=True),
        wide_column("Cannot be distinguished from"),
    ]


def _answers(gap: GapSection) -> Table:
    rows = [explanation_row(answer) for answer in gap.answers[:MOST_ANSWERS]]
    caption = (
        "Explanations of the gap. An effect beside a named one that could be any of"
        " many is reported as an effect of unknown form. " + _decision()
    )
    return Table(_columns(), rows, caption)


def _decision() -> str:
    """When no gap is reported."""
    sure = text.percent(GapSection.NO_GAP_PROBABILITY)
    return (
        "No gap is reported where noise alone, or effects too small for these readings to"
        f" show, have a probability of {sure} or more. What is less likely than noise is a"
        " reason to read again, and is not corrected."
    )


def _credible_set(gap: GapSection) -> Table:
    rows = [explanation_row(answer) for answer in gap.set95]
    caption = (
        "Credible set: with 95 % probability one of these sets of effects acts, with or"
        " without a remainder of unknown form. The remainder is named where it is more"
        " likely than not. An effect stands for all that cannot be distinguished from it."
    )
    return Table(_columns(), rows, caption)


def explanation_row(answer: AnswerRecord) -> list[str]:
    """An explanation, its probability, and what cannot be distinguished from it."""
    aliases = [
        spoken(name)
        for group in answer.classes
        for name in group
        if name not in answer.effects or len(group) >= MANY
    ]
    others = text.listing(dict.fromkeys(aliases)) or text.MISSING
    return [_explanation(answer), text.percent(answer.probability), others]


def _explanation(answer: AnswerRecord) -> str:
    """The effects of an answer; one of a large class is not named before the others."""
    hidden = "too small for these readings to show"
    if answer.classes and answer.unseen >= answer.probability > 0.0:
        return f"an effect {hidden}"
    sizes = {group[0]: len(group) for group in answer.classes if len(group) >= MANY}
    names = [_effect(name, sizes) for name in answer.effects]
    explanation = text.listing(names) or "no gap: noise alone"
    if answer.unseen < MUCH * answer.probability or answer.unseen <= 0.0:
        return explanation
    part = "" if answer.unseen >= answer.probability else "in part "
    return f"{explanation}, {part}{hidden}"


def _effect(name: str, class_sizes: Mapping[str, int]) -> str:
    if name == "unknown":
        return "an effect of unknown form"
    if name in class_sizes:
        return f"one of {class_sizes[name]}"
    return spoken(name)


# -- sizes -----------------------------------------------------------------------------


def _sizes(gap: GapSection) -> Table:
    columns = [
        TableColumn("Effect"),
        wide_column("What it is"),
        *number_columns("Size, rms", "After calibration, rms", "Detectability"),
    ]
    rows = [
        [
            spoken(size.effect),
            _effect_text(gap, size.effect),
            size_in_readings(gap, size.rms),
            size_in_readings(gap, size.remaining) or text.MISSING,
            text.number(size.detectability),
        ]
        for size in gap.sizes
    ]
    caption = (
        "Effects found: how large each is in the readings, and what calibration without"
        " it leaves of that. Detectability: the same as a multiple of the noise over all"
        " readings together; below about 5 an effect is hard to detect."
    )
    if any(_constants(gap, size.effect) for size in gap.sizes):
        caption += (
            " In brackets: what its form depends on, at the likeliest value, in SI"
            " units."
        )
    return Table(columns, rows, caption)


def _effect_text(gap: GapSection, effect: str) -> str:
    """What an effect is, with the constants of its form in SI."""
    about = gap.about[effect].about if effect in gap.about else ""
    constants = _constants(gap, effect)
    if not constants:
        return about
    values = [f"{name} = {text.number(value)}" for name, value in constants.items()]
    return f"{about} ({', '.join(values)})"


def _constants(gap: GapSection, effect: str) -> Mapping[str, float]:
    return gap.constants.get(effect, {})


def size_in_readings(gap: GapSection, sizes: Mapping[str, float]) -> str:
    """Rms by channel; one channel alone needs no name."""
    named = len(gap.units) != 1
    entries = []
    for channel, rms in sizes.items():
        if rms > VISIBLE:
            entry = text.channel_value(channel, rms, gap.units)
            entries.append(f"{channel} {entry}" if named else entry)
    return text.listing(entries)
