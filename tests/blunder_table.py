"""The table of blunders that `docs/reference/blunders.md` shows."""

from __future__ import annotations

import numpy as np
from blunder_table_forms import OF_FORMS
from blunder_table_others import OF_OTHER_MACHINES
from blunders import (
    LENGTH,
    SIGMA,
    Blunder,
    backward,
    copied,
    deviation,
    driven,
    each_run,
    edit,
    exchanged_columns,
    exchanged_runs,
    exchanged_setups,
    half_deviation,
    lost_row,
    mirrored,
    nonsense,
    off_by,
    plus,
    rows_exchanged,
    sorted_in,
    times,
    turned,
    two_machines,
    wrongly_ordered,
)


def a3(name, make, sentence, rows=()) -> Blunder:  # type: ignore[no-untyped-def]
    return Blunder(name, "a3", make, sentence, rows)


def lengths(change, **where):  # type: ignore[no-untyped-def]
    return edit("length_mm", change, **where)


OF_FILE = [
    a3("um in a column of mm", lengths(times(1e3)), "are in um, not in mm"),
    a3("m in a column of mm", lengths(times(1e-3)), "are in m, not in mm"),
    a3("inches", lengths(times(1.0 / 25.4)), "are in inch, not in mm"),
    a3(
        "deviations in place of lengths",
        lengths(deviation),
        "are deviations from the nominal length",
    ),
    a3(
        "deviations in um",
        lengths(lambda v: 1e3 * (v - LENGTH)),
        "are deviations from the nominal length in um",
    ),
    a3(
        "length added to lengths",
        lengths(plus(LENGTH)),
        "the nominal length added twice",
    ),
    a3(
        "sign of the bar's deviation",
        lengths(mirrored),
        "the sign of the deviations of length_mm from the nominal length is reversed",
    ),
    Blunder(
        "columns exchanged",
        "planar",
        exchanged_columns("dy_mm", "dz_mm", run="ruler 1"),
        "the columns dy_mm and dz_mm are exchanged",
    ),
    Blunder(
        "sign of a channel",
        "planar",
        edit("dy_mm", times(-1.0)),
        "the sign of dy_mm is reversed",
    ),
    a3(
        "readings one row late",
        lengths(lambda v: np.roll(v, 1)),
        "the readings stand in the file 1 row too late",
    ),
    a3(
        "runs read backward",
        each_run(backward),
        "the readings of each run are in reversed order",
    ),
    a3(
        "set-ups exchanged", exchanged_setups, "set-ups cup and long_tool are exchanged"
    ),
    a3(
        "circles start at 90 deg",
        edit("psi_deg", turned(90.0)),
        "psi_deg starts 90 deg from where it should",
    ),
    a3(
        "two rows exchanged",
        rows_exchanged,
        "Rows 8 and 17 look exchanged",
        (8, 17),
    ),
    a3(
        "one reading off by 50 sigma",
        off_by((19,), 50.0 * SIGMA),
        "Row 19, column length_mm",
        (19,),
    ),
    a3(
        "three readings off by 10 sigma",
        off_by((5, 30, 40), 10.0 * SIGMA),
        "sigma from the",
        (5, 30, 40),
    ),
    a3(
        "a point lost in one number",
        lengths(times(10.0), rows=(11, 11)),
        "Row 11, column length_mm = 29",
        (11,),
    ),
    a3(
        "a reading copied into the next rows",
        lengths(lambda v: v[[0, 0, 0]], rows=(21, 23)),
        "equal to the last digit at other poses",
        (21, 22, 23),
    ),
    a3(
        "computed, not measured",
        lengths(lambda v: 0.0 * v + LENGTH),
        "of the nominal machine to within",
    ),
    a3(
        "half from another machine",
        two_machines,
        "the readings up to row 21 and those from row 22 fit alone but not together",
    ),
    a3(
        "bar longer by 0.5 mm",
        lengths(plus(0.5)),
        "all readings of length_mm are off by",
    ),
    a3(
        "rounded to 0.01 mm",
        lengths(lambda v: np.round(v, 2)),
        "All readings of length_mm are multiples of 0.01",
    ),
    a3("smoothed readings", lambda rows: rows, "The residuals are only"),
    a3("sign of psi", edit("psi_deg", lambda v: -v % 360.0), ""),
    a3("z 10 mm low", driven(dz=10.0), "z_mm is ... mm too low"),
    a3("sorted by a spreadsheet", sorted_in(""), "the readings are sorted by size"),
    a3(
        "sorted in each run",
        sorted_in("run"),
        "the readings of each run are sorted by size",
    ),
    a3("scale of the bar", lengths(times(1.01)), "too large: the scale or conversion"),
    a3(
        "circles start at 45 deg",
        edit("psi_deg", turned(45.0)),
        "psi_deg starts 45 deg from where it should",
    ),
]

OF_PARTS = [
    a3(
        "a circle at another height",
        driven(run="cup 2", dz=10.0),
        "z_mm in run cup 2 is ... mm too low",
    ),
    a3(
        "the circle of another height",
        driven(run="cup 2", dz=10.0, own_tilts=True),
        "z_mm in run cup 2 is ... mm too low, with theta_deg as this program has it",
    ),
    a3(
        "one run rounded to 0.01 mm",
        lengths(lambda v: np.round(v, 2), run="cup 2"),
        "All readings of length_mm in run cup 2 are multiples of 0.01",
        tuple(range(14, 26)),
    ),
    a3(
        "one circle starts 30 deg late",
        edit("psi_deg", turned(30.0), run="cup 2"),
        "psi_deg starts 30 deg from where it should in run cup 2",
    ),
    a3(
        "one circle starts 17 deg late",
        edit("psi_deg", turned(17.0), run="long_tool 1"),
        "psi_deg starts ... deg from where it should in run long_tool 1",
    ),
    a3(
        "one circle tilted by 1 deg more",
        edit("theta_deg", plus(1.0), run="cup 2"),
        "theta_deg in run cup 2 is ... deg too high",
    ),
    a3(
        "one run in um of deviation",
        lengths(lambda v: 1e3 * (v - LENGTH), run="cup 2"),
        "the readings of run cup 2 are deviations from the nominal length in um",
    ),
    a3(
        "one run in inches",
        lengths(times(1.0 / 25.4), run="cup 2"),
        "the readings of run cup 2 are in inch, not in mm",
    ),
    a3(
        "um from row 33 on",
        lengths(times(1e3), rows=(33, 49)),
        "the readings of rows 33 to 49 are in um, not in mm",
    ),
    a3(
        "reversed deviations in one run",
        lengths(mirrored, run="cup 2"),
        "the sign of the deviations of length_mm in run cup 2",
    ),
    a3(
        "negative lengths in one run",
        lengths(times(-1.0), run="cup 2"),
        "the sign of length_mm in run cup 2 is reversed",
    ),
    a3(
        "one run scaled by a half",
        lengths(times(0.5), run="cup 2"),
        "the readings of run cup 2 are half of what they should be",
    ),
    a3(
        "half of the deviations of one run",
        lengths(half_deviation, run="cup 2"),
        "from the nominal length are half of what they should be",
    ),
    a3(
        "one run sorted",
        lengths(np.sort, run="cup 2"),
        "the readings of run cup 2 are sorted by size",
    ),
    a3(
        "one run in another order",
        lengths(wrongly_ordered, run="cup 2"),
        "the readings of run cup 2 are in another order than their poses",
    ),
    a3(
        "one run backward",
        lengths(backward, run="cup 2"),
        "the readings of run cup 2 are in reversed order",
    ),
    a3("a reading left out", lost_row, "the readings of rows 16 to 25 stand 1 row too"),
    a3(
        "run labels exchanged",
        exchanged_runs("length_mm", "cup 1", "cup 2"),
        "the readings of the runs cup 1 and cup 2 are exchanged",
    ),
    a3(
        "one set-up's readings in both",
        copied("length_mm", "setup", "cup", "long_tool"),
        "the readings of set-up long_tool are those of set-up cup, copied",
    ),
    a3(
        "a run pasted into another",
        copied("length_mm", "run", "cup 1", "long_tool 1"),
        "the readings of run long_tool 1 are those of run cup 1, copied",
    ),
    a3(
        "a run under the wrong set-up",
        driven(run="cup 2", setup="long_tool"),
        "the readings of run cup 2 are of set-up long_tool",
    ),
    a3(
        "the bar zeroed again at row 32",
        lengths(plus(0.2), rows=(32, 49)),
        "all readings of length_mm in rows 32 to 49 are off by",
    ),
    a3(
        "the cup moved between two circles",
        driven(run="cup 2", cup=(0.3e-3, -0.2e-3, 0.4e-3)),
        "what cup is set up on stood elsewhere in run cup 2",
    ),
    a3(
        "a tool 10 mm longer",
        driven(setup_of_rows="long_tool", longer=0.01),
        "the tool of long_tool is ... longer than stated",
    ),
    a3(
        "nonsense in one run",
        lengths(nonsense, run="cup 2"),
        "the readings of run cup 2 contradict all others",
    ),
]

BLUNDERS = [*OF_FILE, *OF_PARTS, *OF_OTHER_MACHINES, *OF_FORMS]
