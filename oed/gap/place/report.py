"""Selection of the blocks to report from all regions of a scan."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from oed.gap.data.diagnosis import Block
from oed.gap.place.legs import ALL
from oed.gap.place.regions import Region

#: log p-value by which a window of the session that lasts to the end may be worse than
#: another and still go first
LASTING = 2.0
#: blocks of a kind that are reported; beyond the first only those with p-values below
BLOCKS, LIKELY = 4, 0.05


@dataclasses.dataclass(frozen=True, slots=True)
class Candidate:
    """A region with its test.

    log_p       logarithm of its single p-value
    p           p-value corrected for the family
    strength    its share of the gap's energy
    energy      that it explains
    """

    region: Region
    log_p: float
    p: float
    strength: float
    energy: float

    @property
    def block(self) -> Block:
        """The block as reported."""
        return Block(self.region.place, self.p, min(self.strength, 1.0))


def select_blocks(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best region of each place, and of overlapping places the best.

    A shift that lasts to the end goes before one that is nearly as good.
    """
    cells = [max(c.region.cells) for c in candidates if c.region.kind == "time"]
    end = max(cells, default=0)

    def badness(candidate: Candidate) -> float:
        region = candidate.region
        lasting = region.kind == "time" and end in region.cells
        return candidate.log_p - (LASTING if lasting else 0.0)

    selected: list[Candidate] = []
    for candidate in sorted(candidates, key=badness):
        kind = candidate.region.kind
        same = [c for c in selected if c.region.kind == kind]
        is_new = _is_new_leg if kind in ("leg", "set-up") else _is_new_block
        if is_new(candidate, same):
            selected.append(candidate)
    return sorted(selected, key=lambda c: c.log_p)


def _is_new_leg(candidate: Candidate, same: Sequence[Candidate]) -> bool:
    """Whether a leg was not selected before; all legs together only come first."""
    place = candidate.region.place
    if place in [c.region.place for c in same]:
        return False
    return place != ALL or not same


def _is_new_block(candidate: Candidate, same: Sequence[Candidate]) -> bool:
    """Whether a block is the first of its kind, or likely and apart from the others."""
    if any(c.region.cells & candidate.region.cells for c in same):
        return False
    return not same or (len(same) < BLOCKS and candidate.p < LIKELY)
