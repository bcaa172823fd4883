"""States a diagnosis in sentences: cause, place, how far the gap shrinks, what next."""

from __future__ import annotations

import collections
import dataclasses
import re
from collections.abc import Iterable, Sequence

import msgspec

from oed.gap.cause.advice import (
    DOUBT,
    MOST_NAMES,
    SURE,
    probability_of,
)
from oed.gap.data import signature
from oed.gap.data.diagnosis import UNKNOWN
from oed.model.effect import Effect, State
from oed.result.gap import (
    EVEN,
    AnswerRecord,
    GapSection,
    SizeRecord,
    visible_probability,
)
from pkm_studies.stages.gap import closures, implausible, scatter
from pkm_studies.stages.gap.explanations import (
    CONSIDERABLE,
    chance_of,
    probability_of_causes,
    second_explanation,
)
from pkm_studies.stages.gap.places import named_places, place_names, place_sentences
from pkm_studies.stages.gap.words import (
    capitalised,
    format_probability,
    join_words,
    plain_name,
)

#: how readings that are taken for it come into the answer
SECOND_SESSION = (
    "Diagnose such readings together with these: `oed diagnose STUDY --readings NEW.csv"
    " --after DIR`, with the folder of this result."
)
#: difference between the probabilities of parts of an answer from which each is given
WORTH_SAYING = 0.01
#: effective number of noise laws below which probabilities are rough
FEW_LAWS = 1.5
#: what to record for an effect's covariate
COLUMNS = {
    "time": "time_s",
    "feed": "feed_mm_min",
    "payload": "payload_N",
    "tension": "tension_1_N and those of the other cables",
    "direction": "direction, with runs both ways (+1 and -1)",
}


def with_sentences(gap: GapSection) -> GapSection:
    """The diagnosis with its findings and next steps as sentences."""
    findings = [
        *_verdict(gap),
        *_sizes(gap),
        *_implausible(gap),
        *_resemblance(gap),
        *second_explanation(gap),
        *_few_laws(gap),
        *place_sentences(gap),
        *closures.sentences(gap),
        *_untested(gap),
    ]
    return msgspec.structs.replace(gap, words=findings, next=_next_steps(gap))


# -- cause -----------------------------------------------------------------------------


def _verdict(gap: GapSection) -> list[str]:
    best = gap.answers[0]
    if gap.scatter is not None:
        return scatter.sentences(gap, gap.scatter)
    if gap.verdict == "none":
        return _no_gap(gap)
    if gap.verdict == "unknown":
        unknown = probability_of(UNKNOWN, gap.answers)
        chance = _chance(gap, unknown)
        is_there = "is" if unknown >= EVEN else "may be"
        testable = len(gap.tried) - len(gap.not_testable)
        return [
            f"There {is_there} a gap that no known effect explains {chance}: it has the form of"
            f" none of the {testable} effects that these readings can test."
        ]
    probability = probability_of_causes(gap)
    chance = _chance(gap, probability)
    comes = "comes" if probability >= EVEN else "may come"
    if gap.verdict == "class":
        return [
            f"The gap {comes} from {_classes(gap)}; these readings cannot tell which"
            f" {chance}."
        ]
    if UNKNOWN in best.effects:
        sure = "" if best.probability == probability else chance_of(best.probability)
        return [
            f"Part of the gap {comes} from {_classes(gap)} {chance}; a remainder has a"
            f" form that no known effect has{sure}."
        ]
    together = " together" if len(gap.selected) > 1 else ""
    return [f"The gap {comes} from {_classes(gap)}{together} {chance}."]


def _chance(gap: GapSection, probability: float) -> str:
    """The probability of a cause, and that of noise alone where it is larger."""
    nothing = sum(a.probability for a in gap.answers if not a.effects)
    chance = f"probability {format_probability(probability)}"
    if nothing > probability:
        chance += f"; noise alone {format_probability(nothing)}"
    return f"({chance})"


def _no_gap(gap: GapSection) -> list[str]:
    """That none is found, and how likely one is that these readings do not show."""
    nothing = gap.answers[0].probability
    unseen = sum(answer.unseen for answer in gap.answers)
    chance = f"(probability {format_probability(nothing)})"
    explains = "explains" if nothing >= EVEN else "may explain"
    words = [
        f"No gap is found: noise alone {explains} what calibration leaves {chance}."
    ]
    if unseen >= CONSIDERABLE:
        part = format_probability(unseen)
        words.append(
            f"Something may act that is too small for these readings to show"
            f" (probability {part})."
        )
    return words


def _classes(gap: GapSection) -> str:
    """Effects that the readings cannot tell apart, `a or b`; clear ones before them.

    Of several, each has its probability where they differ by one percent or more.
    """
    best = gap.answers[0]
    named = [(name,) for name in best.effects if name != UNKNOWN]
    classes = sorted(best.classes or named, key=lambda names: len(names) > 1)
    parts = [_class(gap, names) for names in classes]
    chances = [_probability_of_any(names, gap.answers) for names in classes]
    if max(chances) - min(chances) >= WORTH_SAYING:
        together = zip(parts, chances, strict=True)
        parts = [f"{part}{chance_of(chance)}" for part, chance in together]
        return ", and ".join(parts)
    clear = [part for part, n in zip(parts, classes, strict=True) if len(n) == 1]
    vague = parts[len(clear) :]
    return ", and ".join([join_words(clear), *vague] if clear else vague)


def _probability_of_any(names: Sequence[str], answers: Sequence[AnswerRecord]) -> float:
    """That one of several effects acts, whatever is beside it."""
    acting = [answer for answer in answers if {*names} & {*answer.effects}]
    return sum(answer.visible for answer in acting)


def _class(gap: GapSection, names: Sequence[str]) -> str:
    """The effects of a class, those of a large one by what they have in common."""
    natures = [gap.about[n].nature if n in gap.about else "" for n in names]
    if len(names) <= MOST_NAMES or not all(natures):
        return join_words([plain_name(n) for n in names], "or")
    common = collections.Counter(natures).most_common()
    if len(common) == 1:
        return f"{common[0][0]}: any of {len(names)} effects"
    counted = [f"{nature} ({count})" for nature, count in common]
    return f"one of {len(names)} effects: {join_words(counted, 'or')}"


def _sizes(gap: GapSection) -> list[str]:
    """How large each selected effect is, and how much of it calibration leaves."""
    sentences = []
    for size in gap.sizes:
        parts = []
        for channel, rms in size.rms.items():
            if rms > 0.0:
                unit = gap.units[channel]
                parts.append(f"{channel} by {_format_size(rms)} {unit} rms")
        if parts:
            subject = capitalised(plain_name(size.effect))
            if _is_one_of_several(size.effect, gap):
                subject = f"If it is {plain_name(size.effect)}, it"
            sentences.append(
                f"{subject} changes {join_words(parts)}{_remaining(gap, size)}."
            )
    return sentences


def _is_one_of_several(effect: str, gap: GapSection) -> bool:
    """Whether the best answer has others in an effect's place."""
    classes = gap.answers[0].classes
    return any(effect in names and len(names) > 1 for names in classes)


def _remaining(gap: GapSection, size: SizeRecord) -> str:
    """`; calibration leaves 1.3 um (8 %) of that`.

    Between several channels calibration moves errors: each has its amount alone.
    """
    acting = {c: v for c, v in size.remaining.items() if size.rms.get(c, 0.0) > 0.0}
    if not acting:
        return ""
    amounts = {c: f"{_format_size(v)} {gap.units[c]}" for c, v in acting.items()}
    if len(acting) == 1:
        ((channel, amount),) = amounts.items()
        share = format_probability(acting[channel] / size.rms[channel])
        return f"; calibration leaves {amount} ({share}) of that"
    parts = [f"{amount} of {channel}" for channel, amount in amounts.items()]
    return f"; after calibration there remain {join_words(parts)}"


def _format_size(value: float) -> str:
    if abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.2g}" if abs(value) < 10.0 else f"{value:.1f}"


def _implausible(gap: GapSection) -> list[str]:
    """Coefficients far beyond their expected sizes, of the effects that are named."""
    named = [c for c in gap.coefficients if c.effect in gap.selected]
    return implausible.sentences(
        named, {n: note.check for n, note in gap.about.items()}
    )


def _resemblance(gap: GapSection) -> list[str]:
    """The forms that an unknown effect resembles most, with their probabilities."""
    forms = list(gap.unknown.items())
    likely = [(form, p) for form, p in forms if p >= CONSIDERABLE] or forms[:1]
    if not likely:
        return []
    parts = [f"{form} (probability {format_probability(p)})" for form, p in likely]
    return [
        f"What no known effect explains most resembles: {'; or '.join(parts)}.",
        *_nearest(gap),
    ]


def _nearest(gap: GapSection) -> list[str]:
    """Known causes of the kind of what is unknown."""
    others = [plain_name(name) for name in gap.nearest if name not in gap.selected]
    if not others:
        return []
    return [
        f"Known causes of that kind: {join_words(others)}; but the form is another one."
    ]


def _few_laws(gap: GapSection) -> list[str]:
    """That the probabilities are rough, where few of the tried noise laws count."""
    if gap.effective_laws is None or gap.effective_laws >= FEW_LAWS:
        return []
    return [
        "The probabilities are rough: of the noise laws that were tried one alone suits"
        " these readings."
    ]


# -- what could not be tested, and what next -------------------------------------------


def _untested(gap: GapSection) -> list[str]:
    """Effects that lack a column; those that do not fit the machine are left out."""
    by_column: dict[str, list[str]] = {}
    for name in gap.not_testable:
        column = gap.about[name].column if name in gap.about else ""
        if column:
            by_column.setdefault(column, []).append(plain_name(name))
    if not by_column:
        return []
    parts = [
        f"{join_words(names)} (record {column})" for column, names in by_column.items()
    ]
    return [f"Not tested, because the readings lack a column: {'; '.join(parts)}."]


def _next_steps(gap: GapSection) -> list[str]:
    """The diagnosis' advice; remedies and tests of its effects that it leaves out."""
    steps = [_with_plain_names(text, gap.about) for text in gap.next]
    if gap.selected and closures.may_grow(gap):
        steps.insert(0, closures.unproven(gap))
    places = place_names(gap) if UNKNOWN in gap.answers[0].effects else []
    if places:
        steps.append(f"Look first at {join_words(places)}.")
    for name in _effects_in_question(gap):
        note = gap.about.get(name)
        if note is None:
            continue
        known, effect = " ".join(steps), plain_name(name)
        is_sure = probability_of(name, gap.answers) >= SURE
        doubtful = not is_sure or _is_one_of_several(name, gap)
        if doubtful and note.exposed_by and note.exposed_by not in known:
            steps.append(f"To tell {effect} from the others: {note.exposed_by}.")
        if note.remedy and note.remedy not in known:
            lead = f"If it is {effect}" if doubtful else f"Remedy for {effect}"
            steps.append(f"{lead}: {note.remedy}.")
    if _asks_for_readings(gap):
        steps.append(SECOND_SESSION)
    return list(dict.fromkeys(steps))


def _asks_for_readings(gap: GapSection) -> bool:
    """Whether further readings would make the answer clearer."""
    if gap.verdict == "none":
        return visible_probability(gap.answers) > DOUBT
    open_verdicts = ("class", "unknown", "scatter")
    unsure = gap.effect_reported and gap.answers[0].probability < SURE
    return gap.verdict in open_verdicts or unsure


def _effects_in_question(gap: GapSection) -> list[str]:
    """Effects whose tests and remedies are reported.

    Of a class of many none are, but the likeliest where the gap is that of a set-up: its
    reference is soon read again.
    """
    if not gap.effect_reported:
        return []
    classes = gap.answers[0].classes
    if gap.verdict == "class" and classes:
        of_setup = any(p.block.startswith("set-up") for p in named_places(gap.where))
        many = 1 if of_setup else 0
        listed = [c if len(c) <= MOST_NAMES else c[:many] for c in classes]
        members = [name for c in listed for name in c if name != UNKNOWN]
        return list(dict.fromkeys(members))
    return gap.selected


def _with_plain_names(text: str, effects: Iterable[str]) -> str:
    """A sentence with the effects' names as a person says them."""
    for name in effects:
        text = re.sub(rf"\b{re.escape(name)}\b", plain_name(name), text)
    return capitalised(text)


def columns_to_record(effect: Effect, states: Sequence[State]) -> str:
    """What to record so that an effect can be tested; "" where no column would help."""
    if effect.unfit(states[0].machine) is not None:
        return ""
    columns = []
    for need in effect.needs:
        alone = dataclasses.replace(effect, needs=(need,))
        if signature.untestable(alone, states) is not None:
            options = [_column(part.strip()) for part in need.split(" or ")]
            columns.append(" or ".join(options))
    return ", ".join(columns)


def _column(need: str) -> str:
    """The column of one need, with how many values it must take."""
    name, _, number = need.partition(":")
    number = number.strip()
    if name.startswith("temp_"):
        return f"{name}_C"
    column = COLUMNS.get(name, name)
    if name != "direction" and number:
        return f"{column} with {number} different values"
    return column
