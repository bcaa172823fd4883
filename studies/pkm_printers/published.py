"""Rows of a readings file from published collections of printers' readings."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from oed.text import shorten
from pkm_studies.study import PublishedFile, Row

TOWERS = "abc"
HEIGHTS = ("session", "i", "height_mm", "steps_a", "steps_b", "steps_c")
POINTS = [f"p{point}_{tower}" for point in (1, 2) for tower in TOWERS]
DISTANCES = ("session", "i", "distance_mm", *POINTS)
StepSizes = Mapping[str, list[float]]  #: mm a step of each tower, by session


def delta_v400(folder: Path) -> Iterator[Row]:
    """Four sessions of a linear delta printer (FLSun V400, firmware Klipper, CC0).

    Carriage travel is in steps down from the endstop. `heights.csv` has one probe contact
    a row, `distances.csv` one calliper distance between two positions a row. Session S04
    becomes the set-ups `S04_probe` (one run) and `S04_calliper` (one run of two rows for
    each distance, of which the first is its reference). Raises InputError.
    """
    sessions = PublishedFile(folder / "sessions.json").json_content()
    steps = {s["session"]: s["step_distance_mm"] for s in sessions}
    yield from _heights(PublishedFile(folder / "heights.csv"), steps)
    yield from _distances(PublishedFile(folder / "distances.csv"), steps)


def _heights(file: PublishedFile, steps: StepSizes) -> Iterator[Row]:
    for row in file.csv_rows(HEIGHTS):
        joints = _joints(row, "steps_", steps, file)
        label = {"setup": f"{row['session']}_probe", "run": "1", "order": row["i"]}
        yield label | joints | {"height_mm": row["height_mm"]}


def _distances(file: PublishedFile, steps: StepSizes) -> Iterator[Row]:
    for row in file.csv_rows(DISTANCES):
        run = f"distance {row['i']}"
        label = {"setup": f"{row['session']}_calliper", "run": run}
        first = _joints(row, "p1_", steps, file)
        second = _joints(row, "p2_", steps, file)
        yield label | {"order": "1"} | first
        yield label | {"order": "2"} | second | {"length_mm": row["distance_mm"]}


def _joints(row: Row, prefix: str, steps: StepSizes, file: PublishedFile) -> Row:
    """Joints q1_mm to q3_mm from steps of the towers; repr keeps every digit."""
    try:
        sizes = steps[row["session"]]
        travel = [float(row[prefix + t]) * sizes[k] for k, t in enumerate(TOWERS)]
    except (KeyError, ValueError, IndexError, TypeError) as error:
        problem = f"no step size or no number: {shorten(str(error), 80)}"
        field = f"session {row['session']}, i {row['i']}"
        raise file.error(problem, field) from None
    return {f"q{k + 1}_mm": repr(value) for k, value in enumerate(travel)}


MOTORS = "ABCD"


def hangprinter_hp4(folder: Path) -> Iterator[Row]:
    """44 poses of a cable robot (Hangprinter HP4, MIT).

    `motor_deg.csv` has the motors' angles from the origin, one pose a row;
    `known_xyz_mm.csv` says where a camera saw the mover in the first nine. These become
    the set-ups `known_camera` (where the mover was) and `known_lines` (the four lines
    agree: a gap of 0), the other 35 `other_lines`. Raises InputError.
    """
    motors = PublishedFile(folder / "motor_deg.csv").csv_rows(tuple(MOTORS))
    positions = PublishedFile(folder / "known_xyz_mm.csv").csv_rows("xyz")
    joints = [
        {f"q{k + 1}_deg": row[motor] for k, motor in enumerate(MOTORS)}
        for row in motors
    ]
    for i, position in enumerate(positions):
        label = {"setup": "known_camera", "run": "1", "order": str(i + 1)}
        readings = {f"read_{axis}_mm": position[axis] for axis in "xyz"}
        yield label | joints[i] | readings
    for i, pose in enumerate(joints):
        setup, first = "known_lines", 0
        if i >= len(positions):
            setup = "other_lines"
            first = len(positions)
        label = {"setup": setup, "run": "1", "order": str(i - first + 1)}
        yield label | pose | {"gap_mm": "0"}
