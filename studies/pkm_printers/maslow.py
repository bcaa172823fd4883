"""Maslow (FluidNC): anchors of maslow.yaml or of a log, and the belts of its calibration.

The log's line `CLBM:[{bl:.., br:.., tr:.., tl:..}, ...]` has the lengths of the four belts
at each waypoint, in the plane of the anchors. Two lengths are more than the sled's place
needs, so the belts calibrate themselves. As in the firmware, the lower left anchor is
the origin, the lower right one lies on the x axis, and the belts' lengths are right.
"""

import math
import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from pkm_printers import gcode, words
from pkm_printers.gcode import ENDS, NUMBER, TextLine
from pkm_printers.repeated import pooled, repeated_in_log
from pkm_printers.words import (
    HARMLESS,
    OTHERS,
    READ,
    Word,
    WordTable,
    WrittenWord,
    account,
    costs,
    options,
    same,
)
from pkm_studies.base import InputError
from pkm_studies.csv_table import plain_number
from pkm_studies.importers import (
    ImportedSession,
    ImportRequest,
    Model,
    Row,
    imported_study,
)
from pkm_studies.tables import MachineTable

#: corners in the order of the machine's cables
CORNERS: Final = ("tl", "tr", "br", "bl")
MODEL: Final = "cables_planar"
#: a value of the configuration, `Maslow_tlX: 12.3`, or of the log, `$/Maslow_tlX=12.3`
#: and `$/kinematics/MaslowKinematics/tlX=12.3`
VALUE: Final = re.compile(r"(Maslow_)(\w+)\s*[:=]\s*(\S+)", re.IGNORECASE)
#: a key of a configuration, and the section that newer versions have their values in
ENTRY: Final = re.compile(r"(\s*|.*/)(\w+)\s*[:=]\s*(\S*)")
SECTION: Final = "maslowkinematics"
OLD_KEYS: Final = costs(
    "the firmware that has MaslowKinematics does not read keys of older ones"
)
WAYPOINT: Final = re.compile(r"\{([^{}]*)\}")
BELT: Final = re.compile(rf"\b(tl|tr|bl|br)\s*:\s*({NUMBER}){ENDS}")
MARK: Final = "CLBM:"
#: coordinates that only choose the frame, and their values in the firmware, mm
FRAME: Final = {"blX": 0.0, "blY": 0.0, "brY": 0.0}
#: what the firmware does not identify
FIXED: Final = (
    *("anchor3y", "anchor4x", "anchor4y"),
    *(f"{stem}{k}" for stem in ("l", "scale") for k in (1, 2, 3, 4)),
)
#: share of the smaller side of the frame that the prediction spans about its middle
FRAME_SHARE: Final = 0.25
GROUP: Final = "Maslow"
OLD_GROUP: Final = "Maslow, old key"
MAX_MM: Final = 1e6  #: mm; no anchor is farther away
#: share of the larger side by which belts between rough anchors may fail to meet
MAX_MISFIT: Final = 0.1
LENGTHS: Final = costs("the lengths of the log have it already")
PLACES: Final = tuple(f"{corner}{axis}" for corner in CORNERS for axis in "XYZ")
ANCHORS: Final[dict[str, Word]] = {
    **same(READ, (f"{corner}{axis}" for corner in CORNERS for axis in "XY")),
    **same(
        LENGTHS,
        [*(f"{corner}Z" for corner in CORNERS), "beltEndExtension", "armLength"],
    ),
    **same(
        HARMLESS,
        options(
            "vertical calibration_grid_width_mm_X calibration_grid_height_mm_Y"
            " calibration_grid_size Retract_Current_Threshold Extend_Dist"
            " Calibration_Current_Threshold Acceptable_Calibration_Threshold"
        ),
    ),
    OTHERS: costs(
        "this importer does not know it; lengths of the log may depend on it"
    ),
}
WORDS: Final[WordTable] = {GROUP: ANCHORS, OLD_GROUP: {OTHERS: OLD_KEYS}}
#: readings of a belt at a waypoint, of which the firmware takes the mean
REPEATS: Final = 4
ASSUMED: Final = {"assumed": True, "gap1_mm": 0.5, "gap2_mm": 0.5}
NOT_REPEATED: Final = (
    "Noise: the log has no single readings of the belts, so 0.5 mm is assumed for what they"
    " fail to meet by."
)
PRIOR: Final = """
# How far the true anchors may be from those of the file (standard deviation).
[[prior.tolerance]]
parameters = ["anchor*"]
sigma_mm = 50.0
"""


class MaslowImporter:
    """Reads maslow.yaml and logs, in any order; later values win."""

    name = "maslow"
    about = "Maslow: maslow.yaml, and a log with the belts of its calibration (CLBM)"
    unused = ("--machine", "--map", "--mesh")

    def read(self, request: ImportRequest) -> ImportedSession:
        """Anchors and belt lengths. Raises InputError."""
        lines = gcode.read(request.files)
        written = _written(lines)
        accounts = account(written, _other_keys(lines), WORDS)
        anchors = _anchors(written, lines)
        belts, notes = _belts(lines)
        notes += gcode.order_text(lines)
        _check_closing(belts, anchors, lines)
        noise, about_noise = _noise(lines)
        notes.append(about_noise)
        table = MachineTable(
            model=MODEL,
            fixed=list(FIXED),
            geometry={
                "anchor_mm": anchors.tolist(),
                "home_mm": anchors.mean(axis=0).round(1).tolist(),
                "reach_mm": round(
                    FRAME_SHARE * float(np.ptp(anchors, axis=0).min()), 1
                ),
            },
        )
        setup = {"name": "belts", "instrument": "redundancy"}
        text = imported_study(
            request,
            Model.from_table(table, request.consent),
            "Maslow, its belts calibrated by themselves",
            [setup],
            noise,
            "best_fit",
        )
        listed = "; ".join(
            f"{corner} {x:g}, {y:g}"
            for corner, (x, y) in zip(CORNERS, anchors, strict=True)
        )
        statements = [
            f"Machine: four belts in a plane, anchors {listed} mm.",
            f"Readings: the four belts at {len(belts)} waypoints as set-up belts.",
            *notes,
            *accounts,
        ]
        return ImportedSession(
            study=words.comments([*notes, *accounts]) + text + PRIOR,
            rows=[_row(k, lengths) for k, lengths in enumerate(belts, start=1)],
            statements=statements,
        )


importer = MaslowImporter()


def _written(lines: Sequence[TextLine]) -> list[WrittenWord]:
    """Values with what raises errors; old anchor keys beside newer ones are a group."""
    inside = _section_words(lines)
    phrases: list[WrittenWord] = []
    for line, is_new in zip(lines, inside, strict=True):
        text = line.text.split("#")[0]
        match = ENTRY.match(text) if is_new else VALUE.search(text)
        if match is None or MARK in text:
            continue
        is_old = any(inside) and not is_new and match[2] in PLACES
        group = OLD_GROUP if is_old else GROUP
        phrases.append(WrittenWord(group, match[2], match[3], line.number, line.error))
    return phrases


def _section_words(lines: Sequence[TextLine]) -> list[bool]:
    """Whether each line is of newer firmware: in its section, or a log's path of it."""
    inside = list[bool]()
    depth = -1
    file = ""
    for line in lines:
        entry = ENTRY.match(line.text) if _is_yaml(line) else None
        if line.file != file or (entry and len(entry[1]) <= depth):
            depth = -1
            file = line.file
        inside.append(depth >= 0 or f"{SECTION}/" in line.text.lower())
        if entry and entry[2].lower() == SECTION:
            depth = len(entry[1])
    return inside


def _is_yaml(line: TextLine) -> bool:
    return line.file.lower().endswith((".yaml", ".yml"))


def _other_keys(lines: Sequence[TextLine]) -> list[str]:
    """Keys at the top of a configuration that are none of the machine's values."""
    matches = [
        ENTRY.match(line.text)
        for line in lines
        if _is_yaml(line) and not VALUE.search(line.text)
    ]
    return [match[2] for match in matches if match is not None and not match[1]]


def _anchors(written: Sequence[WrittenWord], lines: Sequence[TextLine]) -> np.ndarray:
    """Places (4, 2) of the anchors, mm. Raises InputError."""
    values = dict(FRAME)
    for word in written:
        if word.group == OLD_GROUP or ANCHORS.get(word.key) is not READ:
            continue
        number = plain_number(word.text)
        if number is None or abs(number) > MAX_MM:
            raise word.error("this is no number of mm", "correct the value")
        values[word.key] = number
        if word.key in FRAME and values[word.key] != FRAME[word.key]:
            problem = (
                "the frame's origin is not the lower left anchor, x not the lower side"
            )
            raise word.error(problem, "give the anchors in the firmware's frame")
    for corner in CORNERS:
        for axis in "XY":
            if f"{corner}{axis}" not in values:
                raise InputError(
                    "missing",
                    "give the maslow.yaml that has it, under MaslowKinematics or as"
                    " Maslow_ and the corner, or the log from its first line on",
                    file=gcode.files_of(lines),
                    field=f"Maslow_{corner}{axis}",
                )
    places = [[values[f"{corner}{axis}"] for axis in "XY"] for corner in CORNERS]
    return np.array(places)


def _belts(lines: Sequence[TextLine]) -> tuple[list[dict[str, float]], list[str]]:
    """Belt lengths at the waypoints, mm, each once; sentences. Raises InputError."""
    waypoints: dict[tuple[float, ...], dict[str, float]] = {}
    count = 0
    for line in lines:
        if MARK not in line.text:
            continue
        content = line.text.partition(MARK)[2]
        if "]" not in content:
            problem = "the line is cut off"
            raise line.error(problem, "give the whole line, up to its bracket ]")
        for text in WAYPOINT.findall(content):
            lengths = {
                corner: gcode.finite(value, line)
                for corner, value in BELT.findall(text)
            }
            far = max(map(abs, lengths.values()), default=0.0) > MAX_MM
            if set(lengths) != set(CORNERS) or far:
                problem = "a waypoint has not the four belts tl, tr, bl, br"
                raise line.error(problem, "give the line as the firmware prints it")
            count += 1
            waypoints[tuple(lengths[corner] for corner in CORNERS)] = lengths
    if not waypoints:
        raise InputError(
            "no belts of a calibration in it",
            "give the log of the calibration too: its line CLBM:[{bl:..., ...}]",
            file=gcode.files_of(lines),
        )
    notes = []
    if count > len(waypoints):
        repeated = count - len(waypoints)
        notes.append(f"Not read: {repeated} waypoints that the log prints again.")
    return list(waypoints.values()), notes


def _noise(lines: Sequence[TextLine]) -> tuple[dict[str, float], str]:
    """The table [noise], and a sentence.

    A length is the mean of four readings of a belt. The gaps are orthonormal combinations of
    the errors of four lengths, over the root of 4.
    """
    spread = pooled(repeated_in_log(lines))
    if spread is None or not spread.is_known:
        return ASSUMED, spread.sentence() if spread else NOT_REPEATED
    gap = round(spread.sigma / math.sqrt(REPEATS) / math.sqrt(len(CORNERS)), 6)
    noise = {"estimate": True, "carried": 0.0, "gap1_mm": gap, "gap2_mm": gap}
    return noise, spread.sentence()


def _check_closing(
    belts: Sequence[dict[str, float]], anchors: np.ndarray, lines: Sequence[TextLine]
) -> None:
    """Refuse belts that meet nowhere near one point. Raises InputError.

    Differences of (x - X_i)^2 + (y - Y_i)^2 = L_i^2 are linear in the sled's place.
    """
    lengths = np.array([[belt[corner] for corner in CORNERS] for belt in belts])
    squares = (anchors**2).sum(axis=1) - lengths**2
    slopes = 2.0 * (anchors - anchors.mean(axis=0))
    sides = (squares - squares.mean(axis=1, keepdims=True)).T
    places = np.linalg.lstsq(slopes, sides, rcond=None)[0].T
    errors = np.linalg.norm(places[:, None] - anchors, axis=2) - lengths
    size = np.ptp(anchors, axis=0).max()
    if (lengths <= 0.0).any() or np.median(
        np.abs(errors).max(axis=1)
    ) > MAX_MISFIT * size:
        corners = ", ".join(f"{c} {v:g}" for c, v in belts[0].items())
        raise InputError(
            f"belts such as {corners} mm do not meet between these anchors",
            "give the anchors of the machine that wrote the log, all in mm",
            file=gcode.files_of(lines),
            field=MARK.rstrip(":"),
        )


def _row(order: int, lengths: dict[str, float]) -> Row:
    label = {"setup": "belts", "run": "1", "order": str(order)}
    joints = {f"q{k}_mm": repr(lengths[c]) for k, c in enumerate(CORNERS, start=1)}
    return label | joints
