"""Words of RepRapFirmware that bear on a delta and its probe, with what is done with them.

After the G-code dictionary of RepRapFirmware 1 to 3 and its LinearDeltaKinematics.
"""

from __future__ import annotations

from typing import Final

from pkm_printers.words import HARMLESS, READ, Word, WordTable, costs, refused, same

MORE_TOWERS: Final = refused(
    "this sets towers beyond the third", "remove it: only three towers hold the tool"
)
IN_HEIGHTS: Final = costs(
    "the heights of the log are without it already; an error of it moves all of z"
)
HEIGHT_MAP: Final = costs(
    "a height map that is on bends z, also after calibration: turn it off (M561) before you"
    " probe, and probe it anew after"
)
RADII: Final = refused(
    "forks of the firmware mean trims of the towers' radii, or of their angles, by it",
    "remove it and add a line radius_trim_mm = x, y, z with the radius trims of the"
    " towers; where they are angles, add them to M665 X, Y, Z",
)

M665: Final[dict[str, Word]] = {
    **same(READ, "LRHBXYZ"),
    **same(RADII, "ACDEFIJK"),
    "S": HARMLESS,
}
M666: Final[dict[str, Word]] = {
    **same(READ, "XYZAB"),
    **same(MORE_TOWERS, "UVW"),
}
G30: Final[dict[str, Word]] = {
    **same(READ, "PXYZK"),
    "H": costs("the heights of the log are without it already"),
    "S": costs(
        "above 0 the firmware calibrates itself from the heights; give the geometry that"
        " it had before"
    ),
}
G31: Final[dict[str, Word]] = {
    **same(READ, "XYK"),
    "Z": IN_HEIGHTS,
    **same(HARMLESS, "PUVWABD"),
    **same(
        costs("the trigger height follows the temperature, which is not modelled"),
        "CSHT",
    ),
}
WORDS: Final[WordTable] = {
    "M665": M665,
    "M666": M666,
    "M669": {
        "K": READ,
        **same(HARMLESS, "ST"),
        **same(MORE_TOWERS, "XY"),
    },
    "M557": same(
        costs("it is the grid of G29; the points of G30 are read"), "XYRSPABCUVW"
    ),
    "M558": {**same(HARMLESS, "CHFTABRSIXYZUVLE"), **same(READ, "PK")},
    "M851": {"Z": IN_HEIGHTS},
    "G30": G30,
    "G31": G31,
    "M92": same(
        costs("steps per mm are taken as right: an error scales the towers' travel"),
        "XYZUVWABCDES",
    ),
    "M579": same(
        costs("the firmware scales x, y and z by it, which the study does not know"),
        "XYZUVW",
    ),
    "M556": same(
        costs("the firmware corrects skew by it, which the study does not know"),
        "SXYZP",
    ),
    "G10": same(
        costs("offsets of a tool move the places of probing where one is selected"),
        "PLXYZUVWRSABCDE",
    ),
    "M98": same(costs("this file may hold further settings: give it too"), "PRXYZSFH"),
    "G20": {"": refused("the numbers are in inches", "give them in mm")},
    "G29": same(HEIGHT_MAP, "SPK"),
    "M375": same(HEIGHT_MAP, "P"),
    # answers of the firmware, and what has no bearing on geometry
    **{name: {} for name in ("G28", "G32", "M500", "M501", "M503", "M561", "M115")},
}
