"""Tables of a column map file: which column of a CSV is what."""

from typing import Literal

from pkm_studies.tables import (
    Count,
    MachineTable,
    NotNegative,
    Positive,
    StudyTable,
    Triple,
)


class CircleFacts(StudyTable, frozen=True, kw_only=True):
    """What a ball-bar trace does not say about its circle.

    centre_mm     of the circle, in machine coordinates
    radius_mm     of the circle
    plane         "xy", "yz" or "zx": angles run from the first axis to the second
    length_mm     of the bar, to which deviations are added; by default the radius
    cup_mm        place of the table's cup; by default the centre
    feed_mm_min   for traces over time
    start_deg     for traces over time: angle of the first point
    direction     for traces over time: "ccw" or "cw"
    feed_in_deg   arc at the start of each run that is no reading
    feed_out_deg  arc at its end, likewise
    readings      readings a run after thinning, at most
    """

    centre_mm: Triple
    radius_mm: Positive
    plane: Literal["xy", "yz", "zx"] = "xy"
    length_mm: Positive | None = None
    cup_mm: Triple | None = None
    feed_mm_min: Positive | None = None
    start_deg: float = 0.0
    direction: Literal["ccw", "cw"] = "ccw"
    feed_in_deg: NotNegative = 0.0
    feed_out_deg: NotNegative = 0.0
    readings: Count = 120


class CircleOfFiles(CircleFacts, frozen=True, kw_only=True):
    """One of several circles, `[[circles]]`: the fields of [circle], and

    files  names of the files that hold it; by default, the first circle is in the first
           file, the second in the second
    runs   numbers of its runs in each of these files, from 1; all by default
    setup  name of the set-up: circles of one mounting of the cup share it. By default
           circles with the same cup and bar do
    """

    files: list[str] = []
    runs: list[Count] = []
    setup: str | None = None


class OrientationColumns(StudyTable, frozen=True, kw_only=True):
    """[orientation] of a column map: columns that give an orientation in another form.

    One of the first four. The program turns them into the angles of the instrument. They
    take vectors of the platform's frame into the instrument's.

    quaternion           columns of w, x, y and z: the scalar first
    rotation_vector_rad  columns of x, y and z: axis times angle, right-handed
    rotation_vector_deg  the same in degrees
    direction            columns of x, y and z of the tool axis, which is z of the
                         platform's frame
    inverse              true where they take the instrument's frame into the platform's
    """

    quaternion: tuple[str, str, str, str] | None = None
    rotation_vector_rad: tuple[str, str, str] | None = None
    rotation_vector_deg: tuple[str, str, str] | None = None
    direction: tuple[str, str, str] | None = None
    inverse: bool = False


class ColumnSource(StudyTable, frozen=True, kw_only=True):
    """A column of a CSV whose numbers are in another unit, or count from another zero.

    The number of the readings is factor x cell + offset, in the unit of their column.

    column  of the CSV
    factor  such as mm a revolution, or mm a count; a list for a column with braces
    offset  in the unit of the readings column; likewise
    k       coverage factor of an uncertainty, 2 for U95: the cell is divided by it
    """

    column: str
    factor: float | list[float] = 1.0
    offset: float | list[float] = 0.0
    k: Positive | None = None


class ColumnMap(StudyTable, frozen=True, kw_only=True):
    """A column map file.

    machine       a name of `oed list machines`, a file of your own, or a table as [machine] of
                  a study: model, geometry, nominal, workspace, home, travel
    instrument    a name of `oed list instruments`, or a file of your own
    setup         name of the set-up
    registration  of a tracker: "free" (identified), "best_fit" (held) or "known"
    tool_mm       tool point in the platform's frame
    targets       of a tracker that reads several: tool point of each, mm, by its name in
                  the column `setup`. They share the frame
    columns       column of the CSV, by column of the readings; or a table with its factor
                  and offset
    orientation   columns of a quaternion, a rotation vector or a direction
    settings      of the instrument, with their unit
    noise         standard deviations of the channels, with their unit
    fixed         coordinates with one value for all readings, with their unit
    circle        what a ball-bar trace does not say
    circles       the same for each of several circles
    """

    machine: str | MachineTable | None = None
    instrument: str | None = None
    setup: str = "setup1"
    registration: Literal["free", "best_fit", "known"] = "free"
    tool_mm: Triple = (0.0, 0.0, 0.0)
    targets: dict[str, Triple] = {}
    columns: dict[str, str | ColumnSource] = {}
    orientation: OrientationColumns | None = None
    settings: dict[str, float] = {}
    noise: dict[str, float] = {}
    fixed: dict[str, float] = {}
    circle: CircleFacts | None = None
    circles: list[CircleOfFiles] = []
