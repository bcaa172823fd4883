"""Records of diagnoses, from the cases of the campaigns."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.blind.case import ALL, DIAGNOSED, PAIRS, WITHHELD
from pkm_campaign import read_row

#: a diagnosis as `run` records it
Record = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Results:
    """Records of a campaign, by the case's id.

    every     with the whole library
    withheld  without the effect that `without` names
    pairs     of the further pairs
    """

    every: Mapping[str, Record]
    withheld: Mapping[str, Record]
    pairs: Mapping[str, Record]


def read(campaign: Path) -> Results:
    """The diagnoses that a campaign's folder has, whether it is done or not."""
    parts: dict[str, dict[str, Record]] = {ALL: {}, WITHHELD: {}, PAIRS: {}}
    for path in sorted((campaign / "cases").glob("*.json")):
        row = read_row(path)
        if row.get(DIAGNOSED):
            parts[row["part"]][row["id"]] = row
    return Results(parts[ALL], parts[WITHHELD], parts[PAIRS])
