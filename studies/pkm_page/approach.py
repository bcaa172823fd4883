"""From which side the next pose is approached, and the sign of it in a readings file.

+1: the first coordinate of the command grows over the last stretch; -1: it falls.
"""

import contextlib
import dataclasses
from typing import Final

from oed.instrument import Setup
from oed.measurement import Measurement
from oed.model import Machine
from pkm_page import rows
from pkm_page.readings_log import FileContent
from pkm_studies.base import InputError
from pkm_studies.resolve import GapRequest
from pkm_studies.study import Study

DIRECTION: Final = "direction"
#: what an effect needs that shows in readings from both sides only
BOTH: Final = "direction: both"
#: cells of the column by the entry; an empty one is not noted
CELLS: Final = {"": "", "+1": "1", "-1": "-1"}


@dataclasses.dataclass(frozen=True)
class Approach:
    """What the page says about the side."""

    sign: str  #: "+1" or "-1", the one to take next
    coordinate: str  #: the first one of the command
    by_pass: bool  #: whether the set-up's protocol has passes both ways, each a reading
    effects: tuple[str, ...]  #: effects of the machine that show from both sides only

    @property
    def verb(self) -> str:
        """What the coordinate does over the last stretch."""
        return "grows" if self.sign == "+1" else "falls"


def effects_of_direction(study: Study, machine: Machine) -> tuple[str, ...]:
    """Effects that a diagnosis of the study tries and that need both directions."""
    tried = GapRequest.from_study(study, machine).effects
    needing = [e for e in tried if BOTH in e.needs]
    return tuple(e.name for e in needing if e.unfit(machine) is None)


def next_approach(
    content: FileContent,
    measurement: Measurement,
    setup: Setup,
    effects: tuple[str, ...],
) -> Approach | None:
    """The side that readings have less often; None where none, or the mean, matters."""
    protocol = setup.protocol
    if protocol.both_directions and protocol.average:
        return None
    if not protocol.both_directions and not effects:
        return None
    up, down = (_count(content, measurement, setup.name, s) for s in (1.0, -1.0))
    coordinate = measurement.machine.command[0].name
    sign = "-1" if down < up else "+1"
    return Approach(sign, coordinate, protocol.both_directions, effects)


def cell(entry: str, approach: Approach | None) -> str:
    """The cell of an entry: 1, -1 or empty. Raises InputError."""
    if entry not in CELLS or (entry and approach is None):
        raise InputError(
            "no such direction here",
            "choose +1, \u22121 or not noted",
            field=DIRECTION,
            value=entry[:24],
        )
    return CELLS[entry]


def shown(cells: dict[str, str]) -> str:
    """A row's direction in words; nothing where it is not noted."""
    sign = _sign(cells)
    if sign is None:
        return ""
    return "direction +1" if sign > 0.0 else "direction \u22121"


def _count(
    content: FileContent, measurement: Measurement, setup: str, sign: float
) -> int:
    taken = [
        content.cells(k)
        for k in range(1, len(content.rows))
        if rows.reading_cells(content, k, measurement)
    ]
    return sum(c["setup"].strip() == setup and _sign(c) == sign for c in taken)


def _sign(cells: dict[str, str]) -> float | None:
    with contextlib.suppress(ValueError):
        sign = float(cells.get(DIRECTION, "").replace(",", "."))
        return sign if abs(sign) == 1.0 else None
    return None
