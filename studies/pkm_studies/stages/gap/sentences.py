"""A diagnosis as sentences: one a finding, the most important first."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Sequence

import msgspec

from oed.effect import Effect, State
from oed.gap.data import signature
from oed.gap.data.diagnosis import UNKNOWN
from oed.result.gap import ClosureRecord, GapSection, PlaceRecord

#: a place counts as found below this p-value
FOUND = 0.05
MOST_PLACES = 3
ALL_LEGS = "all legs"
#: share of the best place's part of the gap that another must hold to be told with it
COMPARABLE = 0.5
#: probability from which a second explanation is told
MATTERS = 0.1
#: probability from which a cause is told as a fact
EVEN = 0.5
#: share closed beyond which the interval's end is not told in figures
FAR = 1.5
#: what must be recorded for an effect's covariate
COLUMNS = {
    "time": "time_s",
    "feed": "feed_mm_min",
    "payload": "payload_N",
    "direction": "direction, with runs both ways (+1 and -1)",
}
SPLITS = {
    "within": "on stretches of runs kept out of the fit",
    "whole": "on whole runs kept out of the fit",
}


def told(gap: GapSection) -> GapSection:
    """The diagnosis with its sentences."""
    words = [
        *_verdict(gap),
        *_likeness(gap),
        *_second(gap),
        *_places(gap),
        *_closures(gap),
        *_untested(gap),
    ]
    return msgspec.structs.replace(gap, words=words, next=_next(gap))


def column(effect: Effect, states: Sequence[State]) -> str:
    """What to record, and how, so that an effect can be tested; "" where no column
    would help.
    """
    if effect.unfit(states[0].machine) is not None:
        return ""
    asked = []
    for need in effect.needs:
        alone = dataclasses.replace(effect, needs=(need,))
        if signature.untestable(alone, states) is not None:
            asked.append(
                " or ".join(_column(part.strip()) for part in need.split(" or "))
            )
    return ", ".join(asked)


def _column(need: str) -> str:
    """The column of one need, with how many values it must take."""
    name, _, wanted = need.partition(":")
    if name.startswith("temp_"):
        return f"{name}_C"
    written = COLUMNS.get(name, name)
    number = wanted.strip()
    if name != "direction" and number:
        written += f" with {number} different values"
    return written


def spoken(name: str) -> str:
    """An effect's name as a person says it: `leg_thermal` -> leg thermal."""
    return "an effect of unknown form" if name == UNKNOWN else name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """a, b and c."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def percent(share: float) -> str:
    """A probability in percent; never 100 % where something is left, nor 0."""
    if 0.995 < share < 1.0:
        return "over 99 %"
    return "under 1 %" if 0.0 < share < 0.005 else f"{100.0 * share:.0f} %"


def _verdict(gap: GapSection) -> list[str]:
    best = gap.answers[0]
    chance = f"(probability {percent(best.probability)})"
    if gap.verdict == "none":
        return [
            "No gap is found: what calibration leaves is what noise alone would leave"
            f" {chance}."
        ]
    if gap.verdict == "unknown":
        return [
            f"There is a gap that no known effect explains {chance}: its cause is not"
            f" in the list of {len(gap.tried) - len(gap.not_testable)} effects that"
            " these readings can test."
        ]
    sizes = _sizes(gap)
    comes = "comes" if best.probability >= EVEN else "may come"
    if gap.verdict == "class":
        return [
            f"The gap {comes} from {_classes(gap)}; these readings cannot tell which"
            f" {chance}{sizes}."
        ]
    named = listed([spoken(n) for n in gap.selected])
    if UNKNOWN in best.effects:
        return [
            f"Part of the gap {comes} from {named} {chance}{sizes}; a remainder has a"
            " form that no known effect has."
        ]
    return [
        f"The gap {comes} from {named}{' together' if len(gap.selected) > 1 else ''}"
        f" {chance}{sizes}."
    ]


def _likeness(gap: GapSection) -> list[str]:
    """What the unknown is like: its likeliest form, and the others that are likely
    enough to matter.
    """
    told = [f"{form} (probability {percent(p)})" for form, p in gap.unknown.items()]
    likely = [
        t for t, p in zip(told, gap.unknown.values(), strict=True) if p >= MATTERS
    ] or told[:1]
    return (
        [f"What no known effect explains is most like: {'; or '.join(likely)}."]
        if likely
        else []
    )


def _second(gap: GapSection) -> list[str]:
    """The next explanation, where it is likely enough to matter."""
    if len(gap.answers) < 2 or gap.answers[1].probability < MATTERS:
        return []
    other = gap.answers[1]
    named = listed([spoken(n) for n in other.effects]) or "no gap at all"
    if other.probability > gap.answers[0].probability:
        return [
            f"Noise alone (probability {percent(other.probability)}) is likelier, but"
            " not enough to be sure of it."
        ]
    return [
        f"The next likely explanation is {named} (probability"
        f" {percent(other.probability)})."
    ]


def _classes(gap: GapSection) -> str:
    """What cannot be told apart: `a or b`, and with it further effects of the answer."""
    classes = gap.answers[0].classes or [[n] for n in gap.answers[0].effects]
    return listed([listed([spoken(n) for n in c], "or") for c in classes], "and")


def _sizes(gap: GapSection) -> str:
    """`: 12.3 um rms of length`, for each selected effect."""
    parts = []
    for size in gap.sizes:
        shown = [
            f"{_number(v)} {gap.units[n]} rms of {n}"
            for n, v in size.rms.items()
            if v > 0.0
        ]
        if shown:
            name = f"{spoken(size.effect)} " if len(gap.sizes) > 1 else ""
            parts.append(name + listed(shown))
    return f": {', '.join(parts)}" if parts else ""


def _number(value: float) -> str:
    return (
        f"{value:.0f}"
        if abs(value) >= 100.0
        else f"{value:.2g}"
        if abs(value) < 10.0
        else f"{value:.1f}"
    )


def _places(gap: GapSection) -> list[str]:
    if gap.verdict == "none" or not gap.where:
        return []
    found = [
        w for w in gap.where if w.p_value < FOUND
    ]  # in the diagnosis' own order: what confines the gap best first
    if found and found[0].block == ALL_LEGS:
        found = [w for w in found if not w.block.startswith("leg ")]
    if found and found[0].strength is not None:
        found = [
            w
            for w in found
            if w.strength is None
            or w.strength >= COMPARABLE * (found[0].strength or 0.0)
        ]
    if not found:
        return [
            "No leg, run, time, direction or part of a run stands out: the gap is"
            " spread over all readings."
        ]
    return [f"It shows most in {listed([_place(w) for w in found[:MOST_PLACES]])}."]


def _place(where: PlaceRecord) -> str:
    kind, _, rest = where.block.partition(" ")
    name = "all legs alike" if where.block == ALL_LEGS else where.block
    if kind == "time":
        low, _, high = rest.partition("-")
        name = f"the time from {_clock(low)} to {_clock(high)}"
    if kind == "phase":
        low, _, high = rest.partition("-")
        name = f"the part from {low} to {high} deg of the runs"
    p = f"p = {where.p_value:.2g}" if where.p_value >= 1e-3 else "p < 0.001"
    return f"{name} ({p})"


def _clock(seconds: str) -> str:
    try:
        return f"{float(seconds) / 60.0:.0f} min"
    except ValueError:
        return seconds


def _closures(gap: GapSection) -> list[str]:
    if gap.verdict == "none":
        return []
    parts = [p for p in (_closed(c) for c in gap.closure) if p]
    if not parts:
        return []
    return [f"With {_subject(gap)} in the model, the gap shrinks by {listed(parts)}."]


def _subject(gap: GapSection) -> str:
    return (
        listed([spoken(n) for n in gap.selected]) if gap.selected else "the remainder"
    )


def _closed(c: ClosureRecord) -> str:
    if c.value is None:
        return ""
    # near the whole, digits enough to tell that something is left
    digits = 0 if c.low is None or c.low < 0.99 else 1 if c.low < 0.999 else 2
    interval = (
        ""
        if c.low is None or c.high is None
        else f" ({_bound(c.low, digits)} to {_bound(c.high, digits)} %)"
    )
    size = (
        f"{_share(c.value, digits)} %"
        if c.value < 1.0
        else "all that the noise lets be seen"
    )
    return f"{size}{interval} {SPLITS.get(c.split, c.split)}"


def _share(value: float, digits: int) -> str:
    """A share in percent with so many decimals, never rounded up to the whole."""
    shown = (
        math.floor(value * 10 ** (digits + 2) + 1e-9)
        if 0.0 < value < 1.0
        else round(value * 10 ** (digits + 2))
    )
    return f"{shown / 10**digits:.{digits}f}"


def _bound(value: float, digits: int) -> str:
    """An end of the interval of a share; far off what a share can be it says no more
    than that.
    """
    if value > FAR:
        return "over 100"
    return "under -100" if value < -1.0 else _share(value, digits)


def _untested(gap: GapSection) -> list[str]:
    """What could not be tested for want of a column; effects that do not fit the
    machine are left out.
    """
    by_column: dict[str, list[str]] = {}
    for name in gap.not_testable:
        if name in gap.about and gap.about[name].column:
            by_column.setdefault(gap.about[name].column, []).append(spoken(name))
    if not by_column:
        return []
    parts = [f"{listed(names)} (record {what})" for what, names in by_column.items()]
    return [f"Not tested, for want of a column in the readings: {'; '.join(parts)}."]


def _next(gap: GapSection) -> list[str]:
    """What the diagnosis says; remedy and exposing reading of the effects in question
    where it does not.
    """
    said = [_readable(text, gap.about) for text in gap.next]
    questioned, doubtful = gap.selected, gap.verdict == "class"
    if doubtful and gap.answers[0].classes:
        questioned = list(
            dict.fromkeys(n for c in gap.answers[0].classes for n in c if n != UNKNOWN)
        )
    for name in questioned if gap.verdict != "none" else []:
        about = gap.about.get(name)
        if about is None:
            continue
        known = " ".join(said)
        if doubtful and about.exposed_by and about.exposed_by not in known:
            said.append(f"To tell {spoken(name)} from the others: {about.exposed_by}.")
        if about.remedy and about.remedy not in known:
            said.append(
                f"{'If it is' if doubtful else 'Against'} {spoken(name)}:"
                f" {about.remedy}."
            )
    return list(dict.fromkeys(said))


def _readable(text: str, known: Iterable[str]) -> str:
    """A sentence with the effects' names as a person says them."""
    for name in known:
        text = re.sub(rf"\b{re.escape(name)}\b", spoken(name), text)
    return text[:1].upper() + text[1:]
