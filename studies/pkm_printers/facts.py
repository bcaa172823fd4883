"""Lines that a user adds to a log, of what the printer does not print of itself.

`probe_radius_mm = 80` stands alone in its line; several numbers are separated by commas.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from oed.text import suggest
from pkm_printers import gcode
from pkm_printers.gcode import TextLine

#: how many numbers each has
COUNTS = {
    "probe_radius_mm": 1,
    "home_height_mm": 1,
    "probe_offset_mm": 2,
    "mesh_x_mm": 2,
    "mesh_y_mm": 2,
    "mesh_radius_mm": 1,
    "radius_trim_mm": 3,
    "rod_trim_mm": 3,
}
VERSION = "firmware_version"
FACT = re.compile(r"\s*([a-z]\w*_mm|firmware_version)\s*=(.*)")


def numbers(lines: Sequence[TextLine]) -> dict[str, tuple[float, ...]]:
    """The numbers of the lines that a user added, by name. Raises InputError."""
    facts = {}
    for line in lines:
        match = FACT.fullmatch(line.text)
        if match is None or match[1] == VERSION:
            continue
        name = match[1]
        if name not in COUNTS:
            remedy = suggest(name, [*COUNTS, VERSION])
            raise line.error("unknown name", remedy, name)
        cells = match[2].split(",")
        if len(cells) != COUNTS[name]:
            problem = f"{len(cells)} numbers, where {COUNTS[name]} belong"
            raise line.error(problem, "separate numbers by commas", name)
        facts[name] = tuple(gcode.finite(cell.strip(), line) for cell in cells)
    return facts


def version(lines: Sequence[TextLine]) -> str | None:
    """The version of the firmware as a user states it; None without."""
    stated = None
    for line in lines:
        match = FACT.fullmatch(line.text)
        if match is not None and match[1] == VERSION:
            stated = match[2].strip()
    return stated
