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


def place_names(gap: GapSection) -> list[str]:
    """The places that are named, without their shares."""
    if not gap.effect_reported:
        return []
    return [_place_name(place.block) for place in named_places(gap.where)]


def named_places(where: Sequence[PlaceRecord]) -> list[PlaceRecord]:
    """Significant places in the diagnosis' order: the one that confines best first.

    Of two places of the same readings the first stands for both.
    """
    places: list[PlaceRecord] = []
    for place in where:
        if place.p_value < SIGNIFICANT and not any(_same(place, o) for o in places):
            places.append(place)
    if not places:
        return []
    best = places[0]
    if best.strength is not None:
        least = COMPARABLE * best.strength
        places = [p for p in places if p.strength is None or p.strength >= least]
    return places[:MAX_PLACES]


def _same(place: PlaceRecord, other: PlaceRecord) -> bool:
    """Whether two places have the same readings."""
    return place.block == other.same_as or place.same_as == other.block


def _place(place: PlaceRecord) -> str:
    """`leg 1 or run 2, which are the same readings (80 % of it)`."""
    name = _place_name(place.block)
    if place.same_as:
        name = f"{name} or {_place_name(place.same_as)}, which are the same readings"
    if place.strength is None:
        return name
    return f"{name} ({format_probability(place.strength)} of it)"


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
