"""44 poses of a cable robot (Hangprinter HP4, MIT).

`motor_deg.csv` has the motors' angles from the origin, one pose a row;
`known_xyz_mm.csv` says where a camera saw the mover in the first nine. These become the
set-ups `known_camera` (where the mover was) and `known_lines` (the four lines agree: a
gap of 0), the other 35 `other_lines`.
"""

from collections.abc import Iterator
from pathlib import Path

from pkm_studies.study import PublishedFile, Row

MOTORS = "ABCD"


def rows(folder: Path) -> Iterator[Row]:
    """Rows of a readings file. Raises InputError."""
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
