"""Orientations of a CSV: quaternions, rotation vectors and directions as angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from oed.base import orientation, units
from oed.base.arrays import Array, Mask
from oed.base.orientation import Orientation
from oed.model.instrument import Instrument
from pkm_studies.base.csv_table import CsvTable
from pkm_studies.base.errors import Place
from pkm_studies.importers.base import Row
from pkm_studies.resolve.quantities import column as usual_column
from pkm_studies.study.tables.column_map import OrientationColumns

#: what a quaternion's length may differ by from 1
UNIT_LENGTH = 1e-2
#: names of the forms in the map
FORMS = ("quaternion", "rotation_vector_rad", "rotation_vector_deg", "direction")


def source_columns(given: OrientationColumns | None) -> tuple[str, ...]:
    """Columns of the CSV that give the orientation."""
    if given is None:
        return ()
    stated = [getattr(given, form) for form in FORMS]
    return tuple(name for names in stated if names is not None for name in names)


def angle_columns(
    given: OrientationColumns, tool: Instrument, table: CsvTable, place: Place
) -> dict[str, list[str]]:
    """Cells of the instrument's angles, by readings column; empty where one is missing.

    Raises InputError.
    """
    form = _form(given, place)
    stated = tool.orientation
    if stated is None:
        raise place.error(
            f"{tool.name} reads no orientation",
            "take an instrument that does: see `oed list instruments`",
        )
    names: Sequence[str] = getattr(given, form)
    values = np.column_stack([table.numbers(name, gaps=True) for name in names])
    complete: Mask = np.asarray(np.isfinite(values).all(axis=1))
    if form == "quaternion":
        _check_quaternions(values, complete, names, table)
    if form == "direction":
        _check_directions(values, complete, names, table)
    matrices = _matrices(form, values[complete], inverse=given.inverse)
    wanted = stated.axis_names if form == "direction" else stated.names
    angles = stated.angles(matrices)
    return {
        usual_column(name, "rad"): _cells(angles[name], complete)
        for name in wanted
        if name in {c.name for c in tool.channels}
    }


def statement(given: OrientationColumns, stated: Orientation) -> str:
    """What was taken for an orientation, in a sentence."""
    form = next(f for f in FORMS if getattr(given, f) is not None)
    names = ", ".join(getattr(given, form))
    words = {
        "quaternion": f"{names} as the quaternion w, x, y, z",
        "direction": f"{names} as the direction of the tool axis",
    }.get(form, f"{names} as a rotation vector in {form.rpartition('_')[2]}")
    sense = "the platform's frame to the instrument's"
    if given.inverse:
        sense = "the instrument's frame to the platform's"
    return f"Orientation: {words}, from {sense}; angles: {stated.formula}."


def rotate_rows(
    rows: Sequence[Row], names: Mapping[str, str], stated: Orientation, by: Rotation
) -> list[Row]:
    """Rows whose orientations are turned by a rotation of the instrument's frame.

    names  column of each angle that the rows have, by angle; those of the axis at least

    An orientation with an empty cell is left out.
    """
    read = {name: _values(rows, label) for name, label in names.items()}
    complete: Mask = np.asarray(
        np.isfinite(np.column_stack(list(read.values()))).all(axis=1)
    )
    absent = np.zeros(len(rows))
    angles = {name: read.get(name, absent)[complete] for name in stated.names}
    matrices = (by * Rotation.from_matrix(stated.matrices(angles))).as_matrix()
    moved = stated.angles(matrices)
    cells = {}
    for name, label in names.items():
        values = np.full(len(rows), np.nan)
        values[complete] = units.from_si(moved[name], label.rpartition("_")[2])
        cells[label] = ["" if v != v else repr(float(v)) for v in values]
    return [
        {**row, **{label: column[k] for label, column in cells.items()}}
        for k, row in enumerate(rows)
    ]


def _form(given: OrientationColumns, place: Place) -> str:
    stated = [form for form in FORMS if getattr(given, form) is not None]
    if len(stated) == 1:
        return stated[0]
    problem = "one form is needed" if not stated else "two forms are given"
    raise place.error(problem, f"give one of {', '.join(FORMS)}")


def _check_quaternions(
    values: Array, complete: Mask, names: Sequence[str], table: CsvTable
) -> None:
    length = np.linalg.norm(np.where(complete[:, None], values, 1.0), axis=1)
    wrong = np.flatnonzero(complete & (np.abs(length - 1.0) > UNIT_LENGTH))
    if wrong.size:
        k = int(wrong[0])
        raise table.error(
            k,
            names[0],
            f"this quaternion has the length {length[k]:.4g}, and a rotation has 1",
            "give the columns in the order w, x, y, z",
        )


def _check_directions(
    values: Array, complete: Mask, names: Sequence[str], table: CsvTable
) -> None:
    length = np.linalg.norm(np.where(complete[:, None], values, 1.0), axis=1)
    wrong = np.flatnonzero(complete & (length == 0.0))
    if wrong.size:
        problem, remedy = "a direction of length 0", "leave its cells empty"
        raise table.error(int(wrong[0]), names[0], problem, remedy)


def _matrices(form: str, values: Array, *, inverse: bool) -> Array:
    """Rotations (n, 3, 3) of complete rows."""
    if not len(values):
        return np.empty((0, 3, 3))
    if form == "direction":
        return orientation.along(-values if inverse else values)
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
