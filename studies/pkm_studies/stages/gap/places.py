"""States the places of a gap: legs, set-ups, runs, times and parts of runs."""

from __future__ import annotations

from collections.abc import Sequence

from oed.result.gap import GapSection, PlaceRecord
from pkm_studies.stages.gap.words import format_probability, join_words

#: a place is named below this probability that it holds no more than an even share
SIGNIFICANT = 0.05
MAX_PLACES = 3
#: share of the best place's strength from which another place is named with it
COMPARABLE = 0.5


def place_sentences(gap: GapSection) -> list[str]:
    """Where the gap shows most; none where no effect is reported."""
    if not gap.effect_reported or not gap.where:
        return []
    places = named_places(gap.where)
    if not places:
        return [
            "No leg, set-up, run, time, direction or part of a run stands out: the gap"
            " is spread over all readings."
        ]
    return [f"It shows most in {join_words([_place(p) for p in places])}."]


def named_places(where: Sequence[PlaceRecord]) -> list[PlaceRecord]:
    """Significant places in the diagnosis' order: the one that confines best first."""
    places = [place for place in where if place.p_value < SIGNIFICANT]
    if not places:
        return []
    best = places[0]
    if best.strength is not None:
        least = COMPARABLE * best.strength
        places = [p for p in places if p.strength is None or p.strength >= least]
    return places[:MAX_PLACES]


def _place(place: PlaceRecord) -> str:
    name = _place_name(place.block)
    notes = []
    if place.strength is not None:
        notes.append(f"{format_probability(place.strength)} of it")
    if place.same_as:
        notes.append(f"in these readings the same as {_place_name(place.same_as)}")
    return f"{name} ({'; '.join(notes)})" if notes else name


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
