"""States a diagnosis in sentences: cause, place, how far the gap shrinks, what next."""

from __future__ import annotations

import collections
import dataclasses
import math
import re
from collections.abc import Iterable, Sequence

import msgspec

from oed.gap.cause.advice import MOST_NAMES, SURE
from oed.gap.data import signature
from oed.gap.data.diagnosis import UNKNOWN
from oed.model.effect import Effect, State
from oed.result.gap import ClosureRecord, GapSection, SizeRecord
from pkm_studies.stages.gap import implausible, scatter
from pkm_studies.stages.gap.places import named_places, place_sentences
from pkm_studies.stages.gap.words import (
    capitalised,
    format_probability,
    join_words,
    plain_name,
)

#: probability from which a second explanation is named
CONSIDERABLE = 0.1
#: probability from which a cause is stated as a fact
EVEN = 0.5
#: how readings that are taken for it come into the answer
SECOND_SESSION = (
    "Diagnose such readings together with these: `oed diagnose STUDY --readings NEW.csv"
    " --after DIR`, with the folder of this result."
)
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
SPLITS = {
    "within": "on held-out stretches of runs",
    "whole": "on whole held-out runs",
}


def with_sentences(gap: GapSection) -> GapSection:
    """The diagnosis with its findings and next steps as sentences."""
    findings = [
        *_verdict(gap),
        *_sizes(gap),
        *_implausible(gap),
        *_resemblance(gap),
        *_second_explanation(gap),
        *_few_laws(gap),
        *place_sentences(gap),
        *_closures(gap),
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
    chance = f"(probability {format_probability(best.probability)})"
    if gap.verdict == "unknown":
        testable = len(gap.tried) - len(gap.not_testable)
        return [
            f"There is a gap that no known effect explains {chance}: its cause is not"
            f" among the {testable} effects that these readings can test."
        ]
    comes = "comes" if best.probability >= EVEN else "may come"
    if gap.verdict == "class":
        return [
            f"The gap {comes} from {_classes(gap)}; these readings cannot tell which"
            f" {chance}."
        ]
    causes = join_words([plain_name(n) for n in gap.selected])
    if UNKNOWN in best.effects:
        return [
            f"Part of the gap {comes} from {causes} {chance}; a remainder has a form that"
            " no known effect has."
        ]
    together = " together" if len(gap.selected) > 1 else ""
    return [f"The gap {comes} from {causes}{together} {chance}."]


def _no_gap(gap: GapSection) -> list[str]:
    """That none is found, and how likely one is that these readings do not show."""
    nothing = gap.answers[0].probability
    unseen = sum(answer.unseen for answer in gap.answers)
    chance = f"(probability {format_probability(nothing)})"
    words = [f"No gap is found: noise alone explains what calibration leaves {chance}."]
    if unseen >= CONSIDERABLE:
        part = format_probability(unseen)
        words.append(
            f"Something may act that is too small for these readings to show"
            f" (probability {part})."
        )
    return words


def _classes(gap: GapSection) -> str:
    """Effects that the readings cannot tell apart, `a or b`, for each of the answer."""
    best = gap.answers[0]
    classes = best.classes or [[name] for name in best.effects]
    return join_words([_class(gap, names) for names in classes])


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
            name = capitalised(plain_name(size.effect))
            sentences.append(
                f"{name} changes {join_words(parts)}{_remaining(gap, size)}."
            )
    return sentences


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
    return [f"What no known effect explains most resembles: {'; or '.join(parts)}."]


def _second_explanation(gap: GapSection) -> list[str]:
    """The next explanation, where its probability is considerable."""
    if len(gap.answers) < 2:
        return []
    best, *others = gap.answers
    second = max(others, key=lambda answer: answer.visible)
    if second.visible < CONSIDERABLE:
        return []
    chance = f"(probability {format_probability(second.visible)})"
    if not second.effects and second.probability > best.probability:
        return [
            f"Noise alone is more likely {chance}, but not likely enough to report no"
            " gap."
        ]
    causes = join_words([plain_name(n) for n in second.effects]) or "no gap at all"
    return [f"The next most likely explanation is {causes} {chance}."]


def _few_laws(gap: GapSection) -> list[str]:
    """That the probabilities are rough, where few of the tried noise laws count."""
    if gap.effective_laws is None or gap.effective_laws >= FEW_LAWS:
        return []
    return [
        "The probabilities are rough: of the noise laws that were tried one alone suits"
        " these readings."
    ]


# -- how far ---------------------------------------------------------------------------


def _closures(gap: GapSection) -> list[str]:
    """How far the gap shrinks on held-out readings, or by how much it grows there."""
    if not gap.effect_reported:
        return []
    known = [(c, c.value) for c in gap.closure if c.value is not None]
    shrinking = [_closure(c, value) for c, value in known if value >= 0.0]
    growing = [_growth(c, value) for c, value in known if value < 0.0]
    causes = join_words([plain_name(n) for n in gap.selected]) or "the remainder"
    lead = (
        f"With {causes} in the model, the mean square of what calibration leaves beyond"
        " the noise"
    )
    sentences = []
    if shrinking:
        sentences.append(f"{lead} shrinks by {join_words(shrinking)}.")
    if growing:
        sentences.append(
            f"{lead} grows by {join_words(growing)}: what was fitted to the other readings"
            " does not carry over to these."
        )
    return sentences


def _closure(closure: ClosureRecord, value: float) -> str:
    """`80 % (60 to 90 %) on whole held-out runs`, of a closure that is no growth."""
    digits = _digits(closure.low)
    if value == 0.0:
        size = "nothing"
    elif value < 1.0:
        size = f"{_format_share(value, digits)} %"
    else:
        size = "all that exceeds the noise"
    interval = _interval(closure, digits)
    return f"{size}{interval} {SPLITS.get(closure.split, closure.split)}"


def _growth(closure: ClosureRecord, value: float) -> str:
    """`40 % (90 % more to 10 % less) on whole held-out runs`, of a closure below 0."""
    size = f"{-100.0 * value:.0f} %{_interval(closure, 0)}"
    return f"{size} {SPLITS.get(closure.split, closure.split)}"


def _interval(closure: ClosureRecord, digits: int) -> str:
    """` (60 to 90 %)`, of which an end below 0 is growth; "" where it is not known."""
    low, high = closure.low, closure.high
    if low is None or high is None:
        return ""
    if low < 0.0:
        return f" ({_bound_in_words(low)} to {_bound_in_words(high)})"
    return f" ({_format_bound(low, digits)} to {_format_bound(high, digits)} %)"


def _bound_in_words(share: float) -> str:
    """`40 % more` or `10 % less`: an end of the interval of a share by which it shrinks."""
    return f"{abs(100.0 * min(share, 1.0)):.0f} % {'more' if share < 0.0 else 'less'}"


def _digits(low: float | None) -> int:
    """Decimals of a percentage: near 100 %, enough to show that something remains."""
    if low is None or low < 0.99:
        return 0
    return 1 if low < 0.999 else 2


def _format_share(value: float, digits: int) -> str:
    """A share in percent, never rounded up to the whole."""
    scaled = value * 10 ** (digits + 2)
    whole = math.floor(scaled + 1e-9) if 0.0 < value < 1.0 else round(scaled)
    return f"{whole / 10**digits:.{digits}f}"


def _format_bound(value: float, digits: int) -> str:
    """An end of the interval of a share; no gap shrinks by more than 100 %."""
    return _format_share(min(value, 1.0), digits)


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
    doubtful = gap.verdict == "class"
    for name in _effects_in_question(gap):
        note = gap.about.get(name)
        if note is None:
            continue
        known, effect = " ".join(steps), plain_name(name)
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
