"""Orientations of a CSV: quaternions, rotation vectors and directions as angles."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from oed import units
from oed.base import Array, Mask, Orientation
from oed.instrument import Instrument
from pkm_studies.base import InputError, Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers.base import Row
from pkm_studies.importers.map_tables import OrientationColumns
from pkm_studies.quantities import column as usual_column

UNIT_LENGTH = 1e-2  #: what a quaternion's length may differ by from 1
#: rms deviation over the spread of the commands, above which orientations may be others
WORST_SHARE: Final = 0.3
#: how many times better another meaning of the columns must fit to be named
MIN_FIT_RATIO: Final = 5.0
#: rad; above 3 deg no registration and no machine to calibrate explains a deviation
WORST_TURN: Final = np.radians(3.0)
MIN_ORIENTATIONS: Final = 4  #: orientations that a comparison takes at least
#: names of the forms in the map
FORMS = ("quaternion", "rotation_vector_rad", "rotation_vector_deg", "direction")


def source_columns(columns: OrientationColumns | None) -> tuple[str, ...]:
    """Columns of the CSV that give the orientation."""
    if columns is None:
        return ()
    stated = [getattr(columns, form) for form in FORMS]
    return tuple(name for names in stated if names is not None for name in names)


def angle_columns(
    columns: OrientationColumns, tool: Instrument, table: CsvTable, location: Location
) -> dict[str, list[str]]:
    """Cells of the instrument's angles, by readings column. Raises InputError."""
    form = _form(columns, location)
    stated = tool.orientation
    if stated is None:
        raise location.error(
            f"{tool.name} reads no orientation",
            "take an instrument that does: see `oed list instruments`",
        )
    names: Sequence[str] = getattr(columns, form)
    values = np.column_stack([table.numbers(name, gaps=True) for name in names])
    complete: Mask = np.asarray(np.isfinite(values).all(axis=1))
    _check_lengths(form, values, complete, names, table)
    matrices = _matrices(form, values[complete], inverse=columns.inverse)
    wanted = stated.axis_names if form == "direction" else stated.names
    angles = stated.angles(matrices)
    return {
        usual_column(name, "rad"): _cells(angles[name], complete)
        for name in wanted
        if name in {c.name for c in tool.channels}
    }


def statement(columns: OrientationColumns, stated: Orientation) -> str:
    """What was taken for an orientation, in a sentence."""
    form = next(f for f in FORMS if getattr(columns, f) is not None)
    names = ", ".join(getattr(columns, form))
    meaning = {
        "quaternion": f"{names} as the quaternion w, x, y, z",
        "direction": f"{names} as the direction of the tool axis",
    }.get(form, f"{names} as a rotation vector in {form.rpartition('_')[2]}")
    sense = "the platform's frame to the instrument's"
    if columns.inverse:
        sense = "the instrument's frame to the platform's"
    return f"Orientation: {meaning}, from {sense}; angles: {stated.formula}."


def rotate_rows(
    rows: Sequence[Row], names: Mapping[str, str], stated: Orientation, by: Rotation
) -> list[Row]:
    """Rows whose orientations are turned by a rotation of the instrument's frame.

    names  column of each angle that the rows have, by angle; those of the axis at least

    An orientation with an empty cell is left out.
    """
    read = row_orientations(rows, names, stated)
    complete: Mask = np.isfinite(read[:, 0, 0])
    moved = stated.angles((by * Rotation.from_matrix(read[complete])).as_matrix())
    cells = {}
    for name, label in names.items():
        values = np.full(len(rows), np.nan)
        values[complete] = units.from_si(moved[name], label.rpartition("_")[2])
        cells[label] = ["" if v != v else repr(float(v)) for v in values]
    return [
        {**row, **{label: column[k] for label, column in cells.items()}}
        for k, row in enumerate(rows)
    ]


def row_orientations(
    rows: Sequence[Row], names: Mapping[str, str], stated: Orientation
) -> Array:
    """Rotations (n, 3, 3) of rows; NaN where a cell is empty. `names` as above."""
    read = {name: _values(rows, label) for name, label in names.items()}
    complete = np.isfinite(np.column_stack(list(read.values()))).all(axis=1)
    absent = np.zeros(len(rows))
    angles = {name: read.get(name, absent)[complete] for name in stated.names}
    matrices = np.full((len(rows), 3, 3), np.nan)
    matrices[complete] = stated.matrices(angles)
    return matrices


# -- order and sense -------------------------------------------------------------------
#
# R_k = A C_k B: what is read, of the commanded C_k. A is the instrument's frame, known
# from the points, and B a constant turn of the target on the platform, the mean of
# C_k^T A^T R_k. What is left is compared with how far the C_k differ.
def check_sense(
    turn: Rotation | None,
    read: Array,
    wanted: Array,
    columns: OrientationColumns | None,
    file: str,
    *,
    is_whole: bool,
) -> None:
    """Raises InputError for orientations in another order, inverted, or of other poses.

    turn      of the instrument's frame into the machine's, A^T
    read      (n, 3, 3) in the instrument's frame, NaN where there is none
    wanted    (n, 3, 3) of the nominal machine, likewise
    is_whole  whether the turn about the tool axis was read too
    """
    used = np.isfinite(read[:, 0, 0]) & np.isfinite(wanted[:, 0, 0])
    if used.sum() < MIN_ORIENTATIONS:
        return
    commanded = Rotation.from_matrix(wanted[used])
    stated = read[used]
    spread, _ = _turns_about_mean(commanded, is_whole=is_whole)

    def misfit(candidate: Rotation) -> tuple[float, float]:
        inner = candidate if turn is None else turn * candidate
        return _turns_about_mean(commanded.inv() * inner, is_whole=is_whole)

    rotation_read = Rotation.from_matrix(stated)
    rms, constant = misfit(rotation_read)
    if rms > WORST_SHARE * spread:
        for remedy, other in _alternatives(rotation_read, columns, is_whole=is_whole):
            if MIN_FIT_RATIO * misfit(other)[0] < rms:
                raise _other_orientation(rms, "", remedy, file)
    if rms > max(WORST_SHARE * spread, WORST_TURN):
        raise _other_orientation(rms, "", "check rows and machine", file)
    if constant > WORST_TURN:
        remedy = "state them for the platform's frame: z along the tool axis, at home unturned"
        raise _other_orientation(
            constant, "by the same turn at all poses, ", remedy, file
        )


def _turns_about_mean(turns: Rotation, *, is_whole: bool) -> tuple[float, float]:
    """Rms angle, rad, of rotations, or their third axes, about their mean; and its own."""
    if is_whole:
        mean = turns.mean()
        angles = np.atleast_1d((mean.inv() * turns).magnitude())
        constant = float(mean.magnitude())
    else:
        axes = turns.apply([0.0, 0.0, 1.0])
        middle = axes.mean(axis=0) / np.linalg.norm(axes.mean(axis=0))
        angles = np.arccos(np.clip(axes @ middle, -1.0, 1.0))
        constant = float(np.arccos(np.clip(middle[2], -1.0, 1.0)))
    return float(np.sqrt(np.mean(angles**2))), constant


def _alternatives(
    rotation_read: Rotation, columns: OrientationColumns | None, *, is_whole: bool
) -> Iterator[tuple[str, Rotation]]:
    """What else the columns may mean, with what to write in the map then."""
    if not is_whole:
        return
    inverse = columns is not None and columns.inverse
    flag = f"write inverse = {str(not inverse).lower()} in [orientation] of the map"
    if columns is None:
        flag = (
            "give the angles of the inverse rotations: these take the instrument's frame"
            " into the platform's"
        )
    yield flag, rotation_read.inv()
    if columns is None or columns.quaternion is None:
        return
    written = (rotation_read.inv() if inverse else rotation_read).as_quat(
        scalar_first=True
    )
    for by in (1, -1):
        names = ", ".join(f'"{name}"' for name in np.roll(columns.quaternion, by))
        order = f"the scalar is another column: write quaternion = [{names}]"
        other = Rotation.from_quat(np.roll(written, by, axis=1), scalar_first=True)
        yield order, other.inv() if inverse else other
        yield f"{order}, and {flag}", other if inverse else other.inv()


def _other_orientation(angle: float, how: str, remedy: str, file: str) -> InputError:
    return InputError(
        f"the orientations are {units.number(angle, 'deg'):.3g} deg rms off the commanded"
        f" ones, {how}after the best turn of the frames",
        remedy,
        file=file,
        field="[orientation]",
    )


def _form(columns: OrientationColumns, location: Location) -> str:
    stated = [form for form in FORMS if getattr(columns, form) is not None]
    if len(stated) == 1:
        return stated[0]
    problem = "one form is needed" if not stated else "two forms are given"
    raise location.error(problem, f"give one of {', '.join(FORMS)}")


def _check_lengths(
    form: str, values: Array, complete: Mask, names: Sequence[str], table: CsvTable
) -> None:
    """Raises InputError for a quaternion that is no rotation, a direction of length 0."""
    length = np.linalg.norm(np.where(complete[:, None], values, 1.0), axis=1)
    if form == "quaternion":
        wrong = np.abs(length - 1.0) > UNIT_LENGTH
        problem = "this quaternion has the length {:.4g}, and a rotation has 1"
        remedy = "give the columns in the order w, x, y, z"
    elif form == "direction":
        wrong = length == 0.0
        problem, remedy = "a direction of length 0", "leave its cells empty"
    else:
        return
    for k in np.flatnonzero(complete & wrong).tolist():
        raise table.error(k, names[0], problem.format(length[k]), remedy)


def _matrices(form: str, values: Array, *, inverse: bool) -> Array:
    """Rotations (n, 3, 3) of complete rows."""
    if not len(values):
        return np.empty((0, 3, 3))
    if form == "direction":
        return Orientation.along(-values if inverse else values)
    if form == "quaternion":
        whole = Rotation.from_quat(values, scalar_first=True)
    else:
        unit = form.rpartition("_")[2]
        whole = Rotation.from_rotvec(units.to_si(values, unit))
    return np.asarray((whole.inv() if inverse else whole).as_matrix())


def _cells(values: Array, complete: Mask) -> list[str]:
    """Cells in degrees; empty where a row has no orientation."""
    numbers = iter(units.from_si(values, "deg").tolist())
    return [repr(next(numbers)) if there else "" for there in complete]


def _values(rows: Sequence[Row], label: str) -> Array:
    """SI values (n,) of a column; NaN where a cell is empty."""
    factor = units.factor(label.rpartition("_")[2])
    return np.array([factor * float(r[label]) if r[label] else np.nan for r in rows])
