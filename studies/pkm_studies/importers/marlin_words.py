"""Words of Marlin that bear on a delta and its probe, with what is done with them.

After Marlin's G-code pages and its M665, M666 and G33 by version.
"""

from __future__ import annotations

from typing import Final

from pkm_studies.importers.marlin_version import NOT_READ, ROD_TRIM, MeaningOfB
from pkm_studies.importers.words import (
    HARMLESS,
    READ,
    Word,
    WordTable,
    costs,
    refused,
    same,
)

RADII: Final = refused(
    "versions and forks mean trims of the towers' radii, or of their angles, by it",
    "remove it and add a line radius_trim_mm = x, y, z with the radius trims of the"
    " towers; where they are angles, write them as M665 X, Y, Z",
)
FORK: Final = refused(
    "only forks of Marlin have this word, each with a meaning of its own",
    "write the geometry as M665 L R H X Y Z and M666 X Y Z; radius trims of the towers"
    " as a line radius_trim_mm = x, y, z",
)
IGNORED: Final = costs("Marlin 2.0.0 to 2.0.5 does not read it: it changes nothing")
FURTHER_AXES: Final = refused("a delta has no such axis", "give the log of the delta")
M665: Final[dict[str, Word]] = {
    **same(READ, "LRHXYZB"),
    "S": HARMLESS,
    **same(RADII, "DEFIJK"),
    **same(FORK, "OPQTUVW"),
}
M666: Final[dict[str, Word]] = {
    **same(READ, "XYZ"),
    **same(FORK, "ABCDEFHIJKLOPQRSTUVW"),
}
G33: Final[dict[str, Word]] = {
    **same(READ, "PO"),
    "R": costs("the radius is read from the report, or from a line probe_radius_mm"),
    **same(HARMLESS, "ACEFTVSXYZ"),
}
BED_LEVELING: Final = costs(
    "with bed leveling on, heights may be those over the mesh: probe with M420 S0"
)


def table(b: MeaningOfB | None, *, has_height: bool) -> WordTable:
    """The words by what M665 B is, and by whether M665 has H.

    M206 moves the home position of versions without H, and is in H of others.
    """
    trims = same(READ, "ABC") if b == ROD_TRIM else same(RADII, "AC")
    if b == NOT_READ:
        trims = same(IGNORED, "ABC")
    height = READ if not has_height else costs("M665 H has it already")
    return {
        "M665": {**M665, **trims},
        "M666": M666,
        "M851": {
            **same(READ, "XY"),
            "Z": READ,
        },
        "M206": {
            **same(READ, "XY"),
            "Z": height,
            **same(FURTHER_AXES, "ABCEPTSUVWIJK"),
        },
        "M428": {"": costs("it changes M206: log the answer of M503 after it")},
        "M92": same(
            costs(
                "steps per mm are taken as right: an error scales the towers' travel"
            ),
            "XYZEABCIJKUVWT",
        ),
        "G29": same(
            costs(
                "its mesh is not read, only lines Bed X: Y: Z: of each place (G29 V4)"
            ),
            "ABCDEFHIJKLNOPQRSTUVWXYZ",
        ),
        "G30": same(READ, "XY") | same(HARMLESS, "CESHVZ"),
        "G33": G33,
        "M420": same(BED_LEVELING, "SZ") | same(HARMLESS, "VLTC"),
        "G20": {"": refused("the numbers are in inches", "give them in mm")},
        **{name: {} for name in ("G28", "M500", "M501", "M503", "M115")},
    }
