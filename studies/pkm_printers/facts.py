"""Lines that a user adds to a log, of what the printer does not print of itself.

`probe_radius_mm = 80` stands alone in its line; several numbers are separated by commas.
"""

import re
from collections.abc import Mapping, Sequence

from oed.text import suggest
from pkm_printers import delta_geometry, gcode
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
NO_TRIMS = (0.0, 0.0, 0.0)  #: trims (3,) of the towers where a user states none, mm
VERSION, FACTORS = "firmware_version", "factors"
FACT = re.compile(r"\s*([a-z]\w*_mm|firmware_version|factors)\s*=(.*)")


def numbers(lines: Sequence[TextLine]) -> dict[str, tuple[float, ...]]:
    """The numbers of the lines that a user added, by name. Raises InputError."""
    facts = {}
    for name, (line, text) in _stated(lines).items():
        if name in (VERSION, FACTORS):
            continue
        if name not in COUNTS:
            remedy = suggest(name, [*COUNTS, VERSION])
            raise line.error("unknown name", remedy, name)
        cells = text.split(",")
        if len(cells) != COUNTS[name]:
            problem = f"{len(cells)} numbers, where {COUNTS[name]} belong"
            raise line.error(problem, "separate numbers by commas", name)
        facts[name] = tuple(gcode.finite(cell.strip(), line) for cell in cells)
    return facts


def trims(
    stated: Mapping[str, tuple[float, ...]], name: str
) -> tuple[float, float, float]:
    """Trims of the towers by a user's line of this name, mm; 0 without."""
    x, y, z = stated.get(name, NO_TRIMS)
    return x, y, z


def version(lines: Sequence[TextLine]) -> str | None:
    """The version of the firmware as a user states it; None without."""
    stated = _stated(lines).get(VERSION)
    return None if stated is None else stated[1]


def factors(
    lines: Sequence[TextLine],
    parameters: Mapping[int, tuple[str, ...]] = delta_geometry.FACTORS,
) -> tuple[str, ...] | None:
    """Parameters by the number of factors wanted; None without. Raises InputError."""
    stated = _stated(lines).get(FACTORS)
    if stated is None:
        return None
    line, text = stated
    choices = [str(number) for number in parameters]
    if text not in choices:
        problem = f"firmwares fit {', '.join(choices)} factors"
        raise line.error(problem, "choose one of them", FACTORS)
    return parameters[int(text)]


def _stated(lines: Sequence[TextLine]) -> dict[str, tuple[TextLine, str]]:
    """The last line that a user added of each name, and its text."""
    matches = ((line, FACT.fullmatch(line.text)) for line in lines)
    return {match[1]: (line, match[2].strip()) for line, match in matches if match}
