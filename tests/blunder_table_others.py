"""Blunders with machines other than the A3."""

from __future__ import annotations

import numpy as np
from blunder_machines import redriven_prs
from blunders import (
    READ_ANGLES,
    READ_PRS,
    TRACKED,
    Blunder,
    edit,
    exchanged_columns,
    exchanged_runs,
    last_references,
    plus,
    rows_by_x,
    times,
    turned_bar,
    turned_legs,
)

OF_OTHER_MACHINES = [
    Blunder(
        "dz in um",
        "planar",
        edit("dz_mm", times(1e3)),
        "dz_mm is in um, not in mm",
    ),
    Blunder(
        "columns of one line exchanged",
        "planar",
        exchanged_columns("dy_mm", "dz_mm", run="ruler 2"),
        "the columns dy_mm and dz_mm are exchanged in run ruler 2",
    ),
    Blunder(
        "sign of dy in one line",
        "planar",
        edit("dy_mm", times(-1.0), run="ruler 2"),
        "the sign of dy_mm in run ruler 2 is reversed",
    ),
    Blunder(
        "sign of dy lost",
        "planar",
        edit("dy_mm", np.abs, setup="ruler"),
        "the sign of dy_mm in set-up ruler is lost",
    ),
    Blunder(
        "dz of one line doubled",
        "planar",
        edit("dz_mm", times(2.0), run="ruler 2"),
        "in run ruler 2 from the nominal machine are twice what they should be",
    ),
    Blunder(
        "told against the last pose",
        "planar",
        last_references,
        "the readings are told against the last pose of each run",
    ),
    Blunder(
        "legs turned by one",
        "hexapod",
        turned_legs,
        "the legs are numbered otherwise: 1 to 6 are 6, 1, 2, 3, 4, 5",
    ),
    Blunder(
        "two legs exchanged",
        "hexapod",
        exchanged_columns("q3_mm", "q4_mm"),
        "the legs are numbered otherwise: 1 to 6 are 1, 2, 4, 3, 5, 6",
    ),
    Blunder(
        "zero of a leg off by 8 mm",
        "hexapod",
        edit("q4_mm", plus(8.0)),
        "dl4 is ... mm from its nominal value",
    ),
    Blunder(
        "x and y of the tracker exchanged",
        "hexapod",
        exchanged_columns("read_x_mm", "read_y_mm"),
        "the columns read_x_mm and read_y_mm are exchanged",
    ),
    Blunder(
        "tracker turned by 90 deg",
        "hexapod",
        exchanged_columns("read_x_mm", "read_y_mm", sign=-1.0),
        "the axes stand otherwise: read_x_mm is read_y_mm, read_y_mm is -read_x_mm",
    ),
    Blunder(
        "angles in rad",
        "hexapod",
        edit(READ_ANGLES, np.deg2rad),
        "are in rad, not in deg",
    ),
    Blunder("poses of one run sorted", "hexapod", rows_by_x, "of run set 2 are sorted"),
    Blunder(
        "tracker moved before a run",
        "hexapod",
        edit("read_x_mm", plus(2.0), run="set 3"),
        "in run set 3",
    ),
    Blunder(
        "poses one row late",
        "hexapod",
        edit(TRACKED, lambda v: np.roll(v, 1)),
        "the readings stand in the file 1 row too late",
    ),
    Blunder(
        "heights of two levels exchanged",
        "delta",
        exchanged_runs("height_mm", "level 1", "level 3"),
        "the readings of the runs level 1 and level 3 are exchanged",
    ),
    Blunder(
        "heights of one level sorted",
        "delta",
        edit("height_mm", np.sort, run="level 2"),
        "the readings of run level 2 are sorted by size",
    ),
    Blunder(
        "deviations on one level",
        "delta",
        edit("height_mm", plus(-120.0), run="level 2"),
        "the readings of run level 2 are deviations from the readings of the nominal",
    ),
    Blunder(
        "one level off by 3 mm",
        "delta",
        edit("height_mm", plus(3.0), run="level 2"),
        "all readings of height_mm in run level 2 are off by",
    ),
    Blunder(
        "calliper in inches",
        "delta",
        edit("length_mm", times(1.0 / 25.4)),
        "calliper are in inch, not in mm",
    ),
    Blunder("sign of x", "delta", edit("x_mm", times(-1.0)), ""),
    Blunder(
        "tilts exchanged",
        "prs",
        exchanged_columns("alpha_deg", "beta_deg"),
        "the columns alpha_deg and beta_deg are exchanged",
    ),
    Blunder(
        "read tilts of one run exchanged",
        "prs",
        exchanged_columns("read_alpha_deg", "read_beta_deg", run="height 2"),
        "the columns read_alpha_deg and read_beta_deg are exchanged in run height 2",
    ),
    Blunder(
        "sign of beta",
        "prs",
        edit("beta_deg", times(-1.0)),
        "the sign of beta_deg is reversed",
    ),
    Blunder(
        "two heights exchanged",
        "prs",
        exchanged_runs(READ_PRS, "height 1", "height 3"),
        "the readings of the runs height 1 and height 3 are exchanged",
    ),
    Blunder(
        "z of one run 5 mm high",
        "prs",
        edit("z_mm", plus(5.0), run="height 2"),
        "z_mm in run height 2 is ... mm too high",
    ),
    Blunder(
        "sliders numbered otherwise",
        "prs",
        redriven_prs,
        "the legs are numbered otherwise",
    ),
    Blunder(
        "frame turned by 3 deg",
        "prs",
        turned_bar,
        "bar.turn_z is ... mrad from its nominal value",
    ),
]
