"""Blunders of several runs at once, of notation, of frames, and of what a display holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from blunder_tables import Array
from blunders import LENGTH, Blunder, Change, Rows, backward, edit, mirrored, times
from scipy.spatial.transform import Rotation

PLACE = ["read_x_mm", "read_y_mm", "read_z_mm"]
ANGLES = ["read_alpha_deg", "read_beta_deg", "read_gamma_deg"]
TEXT_ORDER = np.argsort([str(number) for number in range(1, 13)], kind="stable")


def in_runs(
    columns: str, change: Callable[[Array], Array], runs: Sequence[str]
) -> Change:
    """Columns changed in some runs, each alone."""

    def make(rows: Rows) -> Rows:
        for run in runs:
            rows = edit(columns, change, run=run)(rows)
        return rows

    return make


def under_other_runs(table: Rows) -> Rows:
    """Lengths of the first three circles, each under the name of the next."""
    changed = table.copy()
    names = ["cup 1", "cup 2", "long_tool 1"]
    for name, source in zip(names, [*names[1:], names[0]], strict=True):
        values = table.loc[table["run"] == source, "length_mm"].to_numpy()
        changed.loc[table["run"] == name, "length_mm"] = values
    return changed


def interleaved(table: Rows) -> Rows:
    """Lengths of two circles taken point by point, and pasted as they came."""
    changed = table.copy()
    at = (table["setup"] == "cup").to_numpy()
    by_run = table.loc[at, "length_mm"].to_numpy().reshape(2, -1)
    changed.loc[at, "length_mm"] = by_run.T.ravel()
    return changed


def read_as(change: Callable[[Array, Rotation], tuple[Array, Rotation]]) -> Change:
    """Poses of a tracker, changed as places (n, 3) and rotations."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        turn = Rotation.from_euler("XYZ", table[ANGLES].to_numpy(), degrees=True)
        place, turn = change(table[PLACE].to_numpy(), turn)
        changed[PLACE] = place.round(4)
        changed[ANGLES] = turn.as_euler("XYZ", degrees=True).round(5)
        return changed

    return make


def left_handed(place: Array, turn: Rotation) -> tuple[Array, Rotation]:
    mirror = np.diag([1.0, -1.0, 1.0])
    return place @ mirror, Rotation.from_matrix(mirror @ turn.as_matrix() @ mirror)


def passive(place: Array, turn: Rotation) -> tuple[Array, Rotation]:
    return place, turn.inv()


def in_other_order(place: Array, turn: Rotation) -> tuple[Array, Rotation]:
    """Angles about x, y and z of R = Rz Ry Rx, in columns of R = Rx Ry Rz."""
    about = turn.as_euler("ZYX")[:, ::-1]
    return place, Rotation.from_euler("XYZ", about)


def lagging(values: Array) -> Array:
    """Readings with 30 % of the one that the display showed before."""
    shown = values.copy()
    for k in range(1, len(values)):
        shown[k] = 0.7 * values[k] + 0.3 * shown[k - 1]
    return shown


def clipped(values: Array) -> Array:
    return np.clip(values, LENGTH - 1.0, LENGTH + 1.0)


def wrapped(values: Array) -> Array:
    """Heights of a dial of 1 mm whose revolutions nobody counts."""
    return np.round((values + 0.5) % 1.0 - 0.5, 4)


def interpolated(table: Rows) -> Rows:
    """Lengths of three rows that were not taken, from their neighbours."""
    changed = table.copy()
    middle = table["length_mm"].shift(1) + table["length_mm"].shift(-1)
    for row in (8, 20, 33):
        changed.loc[row, "length_mm"] = round(0.5 * middle[row], 5)
    return changed


def two_digits_exchanged(table: Rows) -> Rows:
    """Length of row 22 with the first and second digit after its point exchanged."""
    changed = table.copy()
    text = f"{table.loc[20, 'length_mm']:.4f}"
    changed.loc[20, "length_mm"] = float(text[:4] + text[5] + text[4] + text[6:])
    return changed


OF_FORMS = [
    Blunder(
        "two of four runs backward",
        "a3",
        in_runs("length_mm", backward, ["cup 2", "long_tool 2"]),
        "the readings of runs ... are in reversed order",
    ),
    Blunder(
        "two runs in um of deviation",
        "a3",
        in_runs("length_mm", lambda v: 1e3 * (v - LENGTH), ["cup 1", "long_tool 2"]),
        "the readings of runs ... are deviations from the nominal length in um",
    ),
    Blunder(
        "reversed deviations in two runs",
        "a3",
        in_runs("length_mm", mirrored, ["cup 2", "long_tool 1"]),
        "the sign of the deviations of length_mm in runs",
    ),
    Blunder(
        "three runs under other names",
        "a3",
        under_other_runs,
        "the readings of the runs stand under other names",
    ),
    Blunder(
        "two runs interleaved",
        "a3",
        interleaved,
        "the readings of set-up cup are interleaved",
    ),
    Blunder(
        "runs in the order of numbers as text",
        "a3",
        in_runs(
            "length_mm",
            lambda v: v[TEXT_ORDER],
            ["cup 1", "cup 2", "long_tool 1", "long_tool 2"],
        ),
        "are in the order of their number as text",
    ),
    Blunder(
        "a decimal point lost in one run",
        "a3",
        edit("length_mm", times(1e4), run="cup 2"),
        "10000 times what they should be: the decimal point is lost",
    ),
    Blunder(
        "tilts in whole degrees",
        "a3",
        edit("theta_deg", np.round),
        "theta_deg is rounded to 1",
    ),
    Blunder(
        "tracker left-handed",
        "hexapod",
        read_as(left_handed),
        "the poses that were read are in a left-handed frame",
    ),
    Blunder(
        "passive rotations",
        "hexapod",
        read_as(passive),
        "angles of the inverse rotation",
    ),
    Blunder(
        "angles in another order",
        "hexapod",
        read_as(in_other_order),
        "angles in another order: R = Rz",
    ),
    Blunder(
        "read before it settled",
        "a3",
        in_runs("length_mm", lagging, ["cup 1", "cup 2", "long_tool 1", "long_tool 2"]),
        "of the reading before as it was shown: read before they had settled",
    ),
    Blunder(
        "a gauge at its ends",
        "a3",
        edit("length_mm", clipped),
        "the ends of the instrument's range: readings beyond are clipped",
    ),
    Blunder(
        "revolutions not counted",
        "delta",
        edit("height_mm", wrapped, setup="probe"),
        "whole revolutions of height_mm",
    ),
    Blunder(
        "interpolated rows",
        "a3",
        interpolated,
        "half-way between the neighbours to the last digit",
        (10, 22, 35),
    ),
    Blunder(
        "two digits exchanged",
        "a3",
        two_digits_exchanged,
        "With two neighbouring digits exchanged it is",
        (22,),
    ),
]
