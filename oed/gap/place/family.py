"""The family of all regions that a gap is looked for in."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.gap.place.legs import legs
from oed.gap.place.path import directions, sectors, single_runs
from oed.gap.place.regions import Region
from oed.gap.place.selected import selected_effects
from oed.gap.place.session import time_windows


def all_regions(
    problem: GapProblem,
    columns: Array | None = None,
    labels: Sequence[str] | None = None,
    known: bool = False,
) -> Iterator[Region]:
    """All regions: of legs, selected effects, runs, time, phase and directions.

    columns, labels    (N, k) of the selected effects, and the blocks they belong to
    known              whether these effects are all that acts; if all of their columns
                       belong to a block, no other regions of legs are tried
    """
    by_effects = bool(known and labels and all(labels))
    if not by_effects:
        yield from legs(problem)
    for region in selected_effects(problem, columns, labels):
        yield dataclasses.replace(region, known=by_effects)
    for family in (single_runs, time_windows, sectors, directions):
        yield from family(problem)
