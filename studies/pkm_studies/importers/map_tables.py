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
    """What a ball-bar trace does not say about its circle."""

    centre_mm: Triple  #: of the circle, in machine coordinates
    radius_mm: Positive  #: of the circle
    #: "xy", "yz" or "zx": angles run from the first axis to the second
    plane: Literal["xy", "yz", "zx"] = "xy"
    #: of the bar, to which deviations are added; by default the radius
    length_mm: Positive | None = None
    cup_mm: Triple | None = None  #: place of the table's cup; by default the centre
    feed_mm_min: Positive | None = None  #: for traces over time
    start_deg: float = 0.0  #: for traces over time: angle of the first point
    direction: Literal["ccw", "cw"] = "ccw"  #: for traces over time: "ccw" or "cw"
    feed_in_deg: NotNegative = 0.0  #: arc at the start of each run that is no reading
    feed_out_deg: NotNegative = 0.0  #: arc at its end, likewise
    readings: Count = 120  #: readings a run after thinning, at most


class CircleOfFiles(CircleFacts, frozen=True, kw_only=True):
    """One of several circles, `[[circles]]`: the fields of [circle], and"""

    #: names of the files that hold it; by default, the first circle is in the first
    #: file, the second in the second
    files: list[str] = []
    #: numbers of its runs in each of these files, from 1; all by default
    runs: list[Count] = []
    #: name of the set-up: circles of one mounting of the cup share it. By default
    #: circles with the same cup and bar do
    setup: str | None = None


class OrientationColumns(StudyTable, frozen=True, kw_only=True):
    """[orientation] of a column map: columns that give an orientation in another form.

    One of the first four. The program turns them into the angles of the instrument. They
    take vectors of the platform's frame into the instrument's.
    """

    #: columns of w, x, y and z: the scalar first
    quaternion: tuple[str, str, str, str] | None = None
    #: columns of x, y and z: axis times angle, right-handed
    rotation_vector_rad: tuple[str, str, str] | None = None
    rotation_vector_deg: tuple[str, str, str] | None = None  #: the same in degrees
    #: columns of x, y and z of the tool axis, which is z of the platform's frame
    direction: tuple[str, str, str] | None = None
    #: true where they take the instrument's frame into the platform's
    inverse: bool = False


class ColumnSource(StudyTable, frozen=True, kw_only=True):
    """A column of a CSV whose numbers are in another unit, or count from another zero.

    The number of the readings is factor x cell + offset, in the unit of their column.
    """

    column: str  #: of the CSV
    #: such as mm a revolution, or mm a count; a list for a column with braces
    factor: float | list[float] = 1.0
    offset: float | list[float] = 0.0  #: in the unit of the readings column; likewise
    #: coverage factor of an uncertainty, 2 for U95: the cell is divided by it
    k: Positive | None = None


class ColumnMap(StudyTable, frozen=True, kw_only=True):
    """A column map file."""

    #: a name of `oed list machines`, a file of your own, or a table as [machine] of a
    #: study: model, geometry, nominal, workspace, home, travel
    machine: str | MachineTable | None = None
    #: a name of `oed list instruments`, or a file of your own
    instrument: str | None = None
    setup: str = "setup1"  #: name of the set-up
    #: of a tracker: "free" (identified), "best_fit" (held) or "known"
    registration: Literal["free", "best_fit", "known"] = "free"
    tool_mm: Triple = (0.0, 0.0, 0.0)  #: tool point in the platform's frame
    #: of a tracker that reads several: tool point of each, mm, by its name in the
    #: column `setup`. They share the frame
    targets: dict[str, Triple] = {}
    #: column of the CSV, by column of the readings; or a table with its factor and
    #: offset
    columns: dict[str, str | ColumnSource] = {}
    #: columns of a quaternion, a rotation vector or a direction
    orientation: OrientationColumns | None = None
    settings: dict[str, float] = {}  #: of the instrument, with their unit
    #: standard deviations of the channels, with their unit
    noise: dict[str, float] = {}
    #: coordinates with one value for all readings, with their unit
    fixed: dict[str, float] = {}
    circle: CircleFacts | None = None  #: what a ball-bar trace does not say
    circles: list[CircleOfFiles] = []  #: the same for each of several circles
