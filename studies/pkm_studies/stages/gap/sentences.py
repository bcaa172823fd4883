"""States a diagnosis in sentences: cause, place, how far the gap shrinks, what next."""

import collections
import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence

from msgspec.structs import replace

from oed import units
from oed.effect_model import Effect, State
from oed.gap import untestable
from oed.result import (
    UNKNOWN,
    AnswerRecord,
    ClosureRecord,
    CoefficientRecord,
    GapSection,
    GoodnessSection,
    PlaceRecord,
    SizeRecord,
    probability_of,
)
from oed.text import capitalised, format_probability, join_words, rounded


# Names of effects in words.
def plain_name(effect: str) -> str:
    """An effect's name as a person says it: `leg_thermal` -> leg thermal."""
    return (
        "an effect of unknown form" if effect == UNKNOWN else effect.replace("_", " ")
    )


# Sentences of a diagnosis about noise: how it departs from the stated one.
def scatter_sentences(gap: GapSection, factor: float) -> list[str]:
    """That readings scatter beyond the instrument, and how."""
    if gap.scatter_against in ("", GapSection.DATA_SHEET):
        first = (
            f"The readings scatter {rounded(factor)} times as much as stated, and no effect"
            " explains it: either the instrument is worse than stated, or something acts"
            " in a form that no effect has."
        )
    else:
        first = (
            f"The readings scatter {rounded(factor)} times as much from pose to pose as where"
            f" they were taken again ({gap.scatter_against}), and no effect explains it."
        )
    phrases = [first, f"What scatters: {'; '.join(gap.noise)}."]
    if gap.scatter_shape.startswith(("leg", "run")):
        phrases.append(f"Most of it is in {gap.scatter_shape}.")
    return phrases


def noise_words(checked: GoodnessSection, gap: GapSection | None) -> list[str]:
    """How the noise departs from the stated one, beside the effects of a diagnosis."""
    if not checked.noise_words or gap is None:
        return checked.noise_words
    return [f"Beside what the diagnosis explains, {'; '.join(gap.noise)}."]


# States in sentences which coefficients are far beyond their expected sizes.

#: coefficient in expected sizes beyond which it is implausible: a normal one of that
#: spread is there once in two million
MAX_SPREADS = 5.0


def implausible_sentences(
    coefficients: Iterable[CoefficientRecord], checks: Mapping[str, str]
) -> list[str]:
    """One sentence an effect with implausible coefficients; checks {effect: what}."""
    worst: dict[str, tuple[float, CoefficientRecord]] = {}
    for c in coefficients:
        ratio = abs(c.value) / c.prior_sd if c.prior_sd and not c.shape else 0.0
        if ratio > worst.get(c.effect, (MAX_SPREADS,))[0]:
            worst[c.effect] = ratio, c
    return [
        _sentence(c, ratio, checks.get(c.effect, "")) for ratio, c in worst.values()
    ]


def _sentence(c: CoefficientRecord, ratio: float, check: str) -> str:
    expected = abs(c.value) / ratio
    effect = c.effect.replace("_", " ")
    advice = f"check {check}"
    if not check:
        advice = (
            f"another cause may look like it. Check {effect} at the machine, or state"
            " its expected size in [effects]"
        )
    return (
        f"{effect[:1].upper()}{effect[1:]}: {c.name} is {_quantity(c.value, c.unit)} (sd"
        f" {_quantity(c.sd, c.unit)}), {rounded(ratio)} times the"
        f" {_quantity(expected, c.unit)} expected. That is implausible: {advice}."
    )


def _quantity(value: float, unit: str) -> str:
    name, factor = units.coefficient_unit(unit)
    amount = value / factor
    if name == "ppm" and abs(amount) >= units.PPM_A_PERCENT:
        return f"{rounded(amount / units.PPM_A_PERCENT, 3)} %"
    return f"{rounded(amount, 3)} {name}"


# States the places of a gap: legs, set-ups, runs, times and parts of runs.

#: a place is named below this probability that it holds no more than an even share
MAX_P_VALUE = 0.05
MAX_PLACES = 3
#: share of the best place's strength from which another place is named with it
MIN_STRENGTH = 0.5


def place_sentences(gap: GapSection) -> list[str]:
    """Where the gap shows most; none where no effect is reported."""
    if not gap.effect_reported or not gap.where:
        return []
    places = named_places(gap.where)
    if not places:
        return [
            "No leg, set-up, run, time, direction or part of a run stands out: the residual error"
            " is spread over all readings."
        ]
    return [f"It shows most in {join_words([_place(p) for p in places])}."]


def place_names(gap: GapSection) -> list[str]:
    """The places that are named, without their shares."""
    if not gap.effect_reported:
        return []
    return [_place_name(record.block) for record in named_places(gap.where)]


def named_places(where: Sequence[PlaceRecord]) -> list[PlaceRecord]:
    """Significant places, the one that confines best first, each reading set once."""
    places: list[PlaceRecord] = []
    for record in where:
        if record.p_value < MAX_P_VALUE and not any(_same(record, o) for o in places):
            places.append(record)
    if not places:
        return []
    best = places[0]
    if best.strength is not None:
        least = MIN_STRENGTH * best.strength
        places = [p for p in places if p.strength is None or p.strength >= least]
    return places[:MAX_PLACES]


def _same(record: PlaceRecord, other: PlaceRecord) -> bool:
    return record.block == other.same_as or record.same_as == other.block


def _place(record: PlaceRecord) -> str:
    """`leg 1 or run 2, which are the same readings (80 % of it)`."""
    name = _place_name(record.block)
    if record.same_as:
        name = f"{name} or {_place_name(record.same_as)}, which are the same readings"
    if record.strength is None:
        return name
    return f"{name} ({format_probability(record.strength)} of it)"


def _place_name(block: str) -> str:
    kind, _, extent = block.partition(" ")
    low, _, high = extent.partition("-")
    if kind == "time":
        return f"the time from {_minutes(low)} to {_minutes(high)}"
    if kind == "phase":
        return f"the part from {low} to {high} deg of the runs"
    return block


def _minutes(seconds: str) -> str:
    try:
        return f"{float(seconds) / 60.0:.0f} min"
    except ValueError:
        return seconds


# Explanations of a gap beside the best one: how probable they are, in sentences.

MIN_SECOND = 0.1  #: probability from which a second explanation is named


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
    phrases = [
        f"An effect of unknown form may act beside it{chance_of(answer.visible)}."
        for answer in rest
        if has_its_causes(answer, gap)
        and UNKNOWN in answer.effects
        and answer.visible >= MIN_SECOND
    ]
    others = [answer for answer in rest if not has_its_causes(answer, gap)]
    if gap.verdict == UNKNOWN:
        # the first sentence counts all answers with something of unknown form
        for answer in others:
            if UNKNOWN in answer.effects and answer.visible >= MIN_SECOND:
                names = tuple(name for name in answer.effects if name != UNKNOWN)
                causes = _spoken(replace(answer, effects=names))
                chance = chance_of(answer.visible)
                phrases.append(f"{capitalised(causes)} may act beside it{chance}.")
        others = [answer for answer in others if UNKNOWN not in answer.effects]
    second = max(others, key=lambda answer: answer.visible, default=best)
    if second is best or second.visible < MIN_SECOND:
        return phrases
    if not second.effects and second.probability > probability_of_causes(gap):
        return [
            *phrases,
            "Noise alone is more likely, but not enough to exclude an effect.",
        ]
    causes = _spoken(second) or "noise alone"
    chance = chance_of(second.visible)
    if gap.verdict == "none" and second.visible > best.probability:
        phrases.append(
            f"More likely than noise alone is {causes}{chance}, but not than noise and what"
            " is too small to be seen together."
        )
        return phrases
    return [*phrases, f"The next most likely explanation is {causes}{chance}."]


def _spoken(answer: AnswerRecord) -> str:
    """An answer's effects, with those that cannot be told from them, or their number."""
    classes = {names[0]: names for names in answer.classes}
    spoken = []
    for name in answer.effects:
        alike = classes.get(name, (name,))
        plain = join_words([plain_name(n) for n in alike], last="or")
        many = len(alike) > GapSection.MAX_CLASS_NAMES
        spoken.append(f"any of {len(alike)} effects" if many else plain)
    has_alternatives = any(len(alike) > 1 for alike in answer.classes)
    return ", and ".join(spoken) if has_alternatives else join_words(spoken)


# States how far the gap shrinks on held-out readings, or by how much it grows.

SPLITS = {"within": "on held-out stretches of runs", "whole": "on whole held-out runs"}


def closure_sentences(gap: GapSection) -> list[str]:
    """How far the gap shrinks on held-out readings, or by how much it grows there."""
    if not gap.effect_reported:
        return []
    closures = [(c, c.value) for c in gap.closure if c.value is not None]
    shrinking = [_closure(c, value) for c, value in closures if value >= 0.0]
    growing = [_growth(c, value) for c, value in closures if value < 0.0]
    causes = join_words([plain_name(n) for n in gap.selected]) or "the remainder"
    lead = (
        f"With {causes} in the model, the mean square of what calibration leaves beyond"
        " the noise"
    )
    phrases = []
    if shrinking:
        phrases.append(f"{lead} shrinks by {join_words(shrinking)}.")
    if growing:
        phrases.append(
            f"{lead} grows by {join_words(growing)}: what was fitted to the other readings"
            " does not carry over to these."
        )
    return phrases


def _closure(closure: ClosureRecord, value: float) -> str:
    """`80 % (60 to 90 %) on whole held-out runs`, of a closure that is no growth."""
    # near 100 %, enough decimals to show that something remains
    digits = 0
    if closure.low is not None and closure.low >= 0.99:
        digits = 1 if closure.low < 0.999 else 2
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
    size = "over 100 %"
    if value >= ClosureRecord.MIN_STATED:
        size = f"{-100.0 * value:.0f} %{_interval(closure, 0)}"
    return f"{size} {SPLITS.get(closure.split, closure.split)}"


def _interval(closure: ClosureRecord, digits: int) -> str:
    """` (60 to 90 %)`, of which an end below 0 is growth; "" where it is not known."""
    low, high = closure.low, closure.high
    if low is None or high is None:
        return ""
    if low < 0.0:
        return f" ({_bound_in_words(low)} to {_bound_in_words(high)})"
    # no gap shrinks by more than 100 %
    shares = [_format_share(min(end, 1.0), digits) for end in (low, high)]
    return f" ({' to '.join(shares)} %)"


def _bound_in_words(share: float) -> str:
    """`40 % more` or `10 % less`: an end of the interval of a share by which it shrinks."""
    if share < ClosureRecord.MIN_STATED:
        return "over 100 % more"
    return f"{abs(100.0 * min(share, 1.0)):.0f} % {'more' if share < 0.0 else 'less'}"


def _format_share(value: float, digits: int) -> str:
    """A share in percent, never rounded up to the whole."""
    scaled, whole = value * 10 ** (digits + 2), 10 ** (digits + 2)
    rounded = round(scaled)
    if value < 1.0 and rounded >= whole:
        rounded = math.floor(scaled)
    return f"{rounded / 10**digits:.{digits}f}"


#: how readings that are taken for it come into the answer
SECOND_SESSION = (
    "Diagnose such readings together with these: `oed diagnose STUDY --readings NEW.csv"
    " --after DIR`, with the folder of this result."
)
#: difference between the probabilities of parts of an answer from which each is given
WORTH_SAYING = 0.01
FEW_LAWS = 1.5  #: effective number of noise laws below which probabilities are rough
#: what to record for an effect's covariate
COLUMNS = {
    "time": "time_s",
    "feed": "feed_mm_min",
    "payload": "payload_N",
    "tension": "tension_1_N and those of the other cables",
    "direction": "direction, with runs both ways (+1 and -1)",
}


def add_sentences(gap: GapSection) -> GapSection:
    """The diagnosis with its findings and next steps as sentences."""
    named = [c for c in gap.coefficients if c.effect in gap.selected]
    checks = {name: note.check for name, note in gap.about.items()}
    rough = []
    if gap.effective_laws is not None and gap.effective_laws < FEW_LAWS:
        rough = [
            "The probabilities are rough: of the noise laws that were tried one alone suits"
            " these readings."
        ]
    findings = [
        *_verdict(gap),
        *_sizes(gap),
        *implausible_sentences(named, checks),
        *_resemblance(gap),
        *_left_out(gap),
        *second_explanation(gap),
        *rough,
        *place_sentences(gap),
        *closure_sentences(gap),
        *_untested(gap),
    ]
    return replace(gap, words=findings, next=_next_steps(gap))


def _verdict(gap: GapSection) -> list[str]:
    best = gap.answers[0]
    if gap.scatter is not None:
        return scatter_sentences(gap, gap.scatter)
    if gap.verdict == "none":
        return _no_gap(gap)
    if gap.verdict == "unknown":
        unknown = probability_of(UNKNOWN, gap.answers)
        chance = _chance(gap, unknown)
        is_there = "is" if unknown >= GapSection.EVEN_PROBABILITY else "may be"
        testable = len(gap.tried) - len(gap.not_testable)
        at_a_size = ", at a size that a machine can have" if gap.left_out else ""
        return [
            f"There {is_there} a residual error that no known effect explains {chance}: it has the form of"
            f" none of the {testable} effects that these readings can test{at_a_size}."
        ]
    probability = probability_of_causes(gap)
    chance = _chance(gap, probability)
    comes = "may come"
    if probability >= GapSection.SURE_PROBABILITY:
        comes = "comes"
    elif probability >= GapSection.EVEN_PROBABILITY:
        comes = "probably comes"
    if gap.verdict == "class":
        return [
            f"The residual error {comes} from {_classes(gap)}; these readings cannot tell which"
            f" {chance}."
        ]
    if UNKNOWN in best.effects:
        sure = "" if best.probability == probability else chance_of(best.probability)
        return [
            f"Part of the residual error {comes} from {_classes(gap)} {chance}; a remainder has a"
            f" form that no known effect has{sure}."
        ]
    together = " together" if len(gap.selected) > 1 else ""
    return [f"The residual error {comes} from {_classes(gap)}{together} {chance}."]


def _chance(gap: GapSection, probability: float) -> str:
    """The probability of a cause, and that of noise alone where it is larger."""
    nothing = sum(a.probability for a in gap.answers if not a.effects)
    # a cause is never certain: what else may act has rounded to nothing
    chance = f"probability {format_probability(min(probability, 1.0 - 1e-9))}"
    if nothing > probability:
        chance += f"; noise alone {format_probability(nothing)}"
    return f"({chance})"


def _no_gap(gap: GapSection) -> list[str]:
    """That none is found, and how likely one is that these readings do not show."""
    nothing = gap.answers[0].probability
    unseen = sum(answer.unseen for answer in gap.answers)
    chance = f"(probability {format_probability(nothing)})"
    explains = "explains" if nothing >= GapSection.EVEN_PROBABILITY else "may explain"
    phrases = [
        f"No effect is found: noise alone {explains} what calibration leaves {chance}."
    ]
    if unseen >= MIN_SECOND:
        part = format_probability(unseen)
        phrases.append(
            f"Something may act that is too small for these readings to show"
            f" (probability {part})."
        )
    return phrases


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
    if len(names) <= GapSection.MAX_CLASS_NAMES or not all(natures):
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


def _left_out(gap: GapSection) -> list[str]:
    """Effects that fit, and why they are not named."""
    return [
        f"{capitalised(plain_name(name))} would fit, but only at a size that no machine"
        " has or in a form that withheld readings refute: it is not named."
        for name in gap.left_out
    ]


def _resemblance(gap: GapSection) -> list[str]:
    """The forms that an unknown effect resembles most, with their probabilities."""
    forms = list(gap.unknown.items())
    likely = [(form, p) for form, p in forms if p >= MIN_SECOND] or forms[:1]
    if not likely:
        return []
    parts = [f"{form} (probability {format_probability(p)})" for form, p in likely]
    named = {*gap.selected, *gap.left_out}
    others = [plain_name(name) for name in gap.nearest if name not in named]
    nearest = []
    if others:
        nearest = [
            f"Known causes of that kind: {join_words(others)}; but the form is another one."
        ]
    return [
        f"What no known effect explains most resembles: {'; or '.join(parts)}.",
        *nearest,
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
    steps = [_plain_text(text, gap.about) for text in gap.next]
    lows = [closure.low for closure in gap.closure if closure.low is not None]
    if gap.selected and lows and max(lows) < 0.0:
        harms = [
            closure.p_worse for closure in gap.closure if closure.p_worse is not None
        ]
        chance = f" (probability {format_probability(max(harms))})" if harms else ""
        advice = (
            "Measure before you exchange or correct anything: on held-out readings the"
            f" correction may do harm{chance}."
        )
        steps.insert(0, advice)
    places = place_names(gap) if UNKNOWN in gap.answers[0].effects else []
    if places:
        steps.append(f"Look first at {join_words(places)}.")
    for name in _effects_in_question(gap):
        note = gap.about.get(name)
        if note is None:
            continue
        named_steps, effect = " ".join(steps), plain_name(name)
        is_sure = probability_of(name, gap.answers) >= GapSection.SURE_PROBABILITY
        doubtful = not is_sure or _is_one_of_several(name, gap)
        if doubtful and note.exposed_by and note.exposed_by not in named_steps:
            steps.append(f"To tell {effect} from the others: {note.exposed_by}.")
        if note.remedy and note.remedy not in named_steps:
            lead = f"If it is {effect}" if doubtful else f"Remedy for {effect}"
            steps.append(f"{lead}: {note.remedy}.")
    asks_for_readings = gap.visible_probability > GapSection.DOUBT_PROBABILITY
    if gap.verdict != "none":
        open_verdicts = ("class", "unknown", "scatter")
        unsure = gap.answers[0].probability < GapSection.SURE_PROBABILITY
        asks_for_readings = gap.verdict in open_verdicts or (
            gap.effect_reported and unsure
        )
    if asks_for_readings:
        steps.append(SECOND_SESSION)
    return list(dict.fromkeys(steps))


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
        listed = [
            c if len(c) <= GapSection.MAX_CLASS_NAMES else c[:many] for c in classes
        ]
        members = [name for c in listed for name in c if name != UNKNOWN]
        return list(dict.fromkeys(members))
    return gap.selected


def _plain_text(text: str, effects: Iterable[str]) -> str:
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
        if untestable(alone, states) is not None:
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
