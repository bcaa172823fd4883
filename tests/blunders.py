"""Blunders of a workshop, each made in a readings file of an independent machine.

A blunder changes a column of readings or commands (`edits`), or has the machine driven
otherwise than the file says; it states what a check must say of it.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from blunder_machines import redriven_a3
from blunder_tables import Array

Rows = pd.DataFrame
Change = Callable[[Rows], Rows]
Edit = Callable[[Array], Array]

LENGTH = 300.0  # mm, of the bar
SIGMA = 0.5e-3  # mm
#: row of a file that the first reading is in
FIRST_ROW = 2


@dataclasses.dataclass(frozen=True)
class Blunder:
    """A blunder.

    name      of it
    machine   in whose readings it is made
    make      rows with the blunder, of rows without
    sentence  words of the finding, ` ... ` for a number; "" where the readings cannot
              reveal the blunder
    rows      rows of the file that must be named; none where all are at fault
    """

    name: str
    machine: str
    make: Change
    sentence: str
    rows: tuple[int, ...] = ()

    def is_named(self, sentences: Sequence[str]) -> bool:
        """Whether one of the sentences has the words of the finding."""
        words = [re.escape(part) for part in self.sentence.split(" ... ")]
        return any(re.search(" .*".join(words), one) for one in sentences)


def edit(
    columns: str,
    change: Edit,
    run: str = "",
    setup: str = "",
    rows: tuple[int, int] | None = None,
) -> Change:
    """Columns, changed in a run, in a set-up, in rows of the file from one to another."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        at = np.ones(len(table), dtype=bool)
        if run:
            at &= (table["run"] == run).to_numpy()
        if setup:
            at &= (table["setup"] == setup).to_numpy()
        if rows is not None:
            number = np.arange(len(table)) + FIRST_ROW
            at &= (rows[0] <= number) & (number <= rows[1])
        for column in columns.split():
            changed.loc[at, column] = change(table.loc[at, column].to_numpy())
        return changed

    return make


def times(factor: float) -> Edit:
    return lambda values: values * factor


def plus(amount: float) -> Edit:
    return lambda values: values + amount


def turned(degrees: float) -> Edit:
    return lambda values: (values + degrees) % 360.0


def backward(values: Array) -> Array:
    return values[::-1]


def exchanged_columns(one: str, other: str, run: str = "", sign: float = 1.0) -> Change:
    """Two columns exchanged, the first with a sign."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        at = (table["run"] == run) if run else np.ones(len(table), dtype=bool)
        changed.loc[at, one] = sign * table.loc[at, other]
        changed.loc[at, other] = table.loc[at, one]
        return changed

    return make


def exchanged_runs(columns: str, one: str, other: str) -> Change:
    """Readings of two runs exchanged."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        first, second = (table["run"] == name for name in (one, other))
        for column in columns.split():
            changed.loc[first, column] = table.loc[second, column].to_numpy()
            changed.loc[second, column] = table.loc[first, column].to_numpy()
        return changed

    return make


def copied(column: str, by: str, source: str, target: str) -> Change:
    """Readings of one run or set-up in the rows of another one."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        values = table.loc[table[by] == source, column].to_numpy()
        changed.loc[table[by] == target, column] = values
        return changed

    return make


def sorted_in(by: str) -> Change:
    """Lengths sorted by size, in each run or set-up, or (`""`) in the file."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        if not by:
            changed["length_mm"] = np.sort(table["length_mm"])
            return changed
        groups = table.groupby(by, sort=False)["length_mm"]
        changed["length_mm"] = groups.transform(np.sort)
        return changed

    return make


def each_run(change: Edit) -> Change:
    """Lengths of each run, changed."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        groups = table.groupby("run", sort=False)["length_mm"]
        changed["length_mm"] = groups.transform(lambda v: change(v.to_numpy()))
        return changed

    return make


def one_instrument(change: Edit, *uses: tuple[str, str]) -> Change:
    """Columns of set-ups, each `(set-up, column)`, changed alike."""

    def make(table: Rows) -> Rows:
        changed = table
        for setup, column in uses:
            changed = edit(column, change, setup=setup)(changed)
        return changed

    return make


def clocked(
    change: Edit,
    start: float = 32400.0,
    step: float = 20.0,
    *,
    run: str = "",
    rows: tuple[int, int] | None = None,
) -> Change:
    """Times, s, of one reading a step from a start on, changed in a run or in rows."""

    def make(table: Rows) -> Rows:
        times = start + step * np.arange(len(table))
        return edit("time_s", change, run=run, rows=rows)(table.assign(time_s=times))

    return make


def wrapped(turn: float) -> Edit:
    """Times of a display that begins again after a turn, s."""
    return lambda times: times % turn


def after_one(times: Array) -> Array:
    """Times of a dial of 12 hours, on which 1 follows 12."""
    return np.where(times >= 46800.0, times - 43200.0, times)


def clock_of_each_run(table: Rows) -> Rows:
    """Times from the first reading of each run on."""
    return table.assign(time_s=20.0 * table.groupby("run", sort=False).cumcount())


def last_references(table: Rows) -> Rows:
    """Readings of each line against its last pose in place of its first."""
    changed = table.copy()
    for run in table["run"].unique():
        at = (table["run"] == run).to_numpy()
        for column in ("dy_mm", "dz_mm"):
            values = table.loc[at, column].to_numpy()
            if np.isfinite(values[1:]).all():
                moved = values - values[-1]
                changed.loc[at, column] = moved
    return changed


def rows_by_x(table: Rows) -> Rows:
    """Poses of one run of the tracker sorted by x, beside its joints as they were."""
    changed = table.copy()
    columns = [c for c in table if c.startswith("read")]
    at = table["run"] == "set 2"
    by_x = table.loc[at, columns].sort_values("read_x_mm")
    changed.loc[at, columns] = by_x.to_numpy()
    return changed


def turned_legs(table: Rows) -> Rows:
    """Leg lengths in the columns of the legs before them."""
    changed = table.copy()
    legs = [f"q{k}_mm" for k in range(1, 7)]
    changed[legs] = np.roll(table[legs].to_numpy(), -1, axis=1)
    return changed


def turned_bar(table: Rows) -> Rows:
    """The laser ball bar's frame turned by 3 deg about its gimbal."""
    changed = table.copy()
    cos, sin = np.cos(np.deg2rad(3.0)), np.sin(np.deg2rad(3.0))
    x, y = table["read_x_mm"], table["read_y_mm"] + 700.0
    changed["read_x_mm"] = cos * x - sin * y
    changed["read_y_mm"] = sin * x + cos * y - 700.0
    alpha, beta = (np.deg2rad(table[f"read_{n}_deg"]) for n in ("alpha", "beta"))
    axis = np.sin(beta), -np.sin(alpha) * np.cos(beta), np.cos(alpha) * np.cos(beta)
    side = cos * axis[0] - sin * axis[1], sin * axis[0] + cos * axis[1]
    changed["read_alpha_deg"] = np.rad2deg(np.arctan2(-side[1], axis[2]))
    changed["read_beta_deg"] = np.rad2deg(np.arcsin(side[0]))
    return changed


def driven(**otherwise: object) -> Change:
    """An A3 head driven otherwise than the file says."""
    return lambda table: redriven_a3(table, **otherwise)


def exchanged_setups(table: Rows) -> Rows:
    """Rows of each set-up under the name of the other."""
    names = {"cup": "long_tool", "long_tool": "cup"}
    return table.assign(setup=table["setup"].replace(names))


def two_machines(table: Rows) -> Rows:
    """Readings from row 22 on of another machine."""
    changed = table.copy()
    changed.loc[20:, "length_mm"] = table.attrs["other"]["length_mm"][20:]
    return changed


def rows_exchanged(table: Rows) -> Rows:
    changed = table.copy()
    changed.loc[[6, 15], "length_mm"] = table.loc[[15, 6], "length_mm"].to_numpy()
    return changed


def off_by(rows: tuple[int, ...], amount: float) -> Change:
    """Lengths of some rows off by an amount, mm."""

    def make(table: Rows) -> Rows:
        changed = table.copy()
        changed.loc[[row - FIRST_ROW for row in rows], "length_mm"] += amount
        return changed

    return make


def lost_row(table: Rows) -> Rows:
    """Lengths of rows 16 to 24 each one row too early: one was left out."""
    changed = table.copy()
    changed.loc[14:22, "length_mm"] = table.loc[15:23, "length_mm"].to_numpy()
    return changed


def deviation(values: Array) -> Array:
    return values - LENGTH


def mirrored(values: Array) -> Array:
    return 2.0 * LENGTH - values


def half_deviation(values: Array) -> Array:
    return LENGTH + 0.5 * (values - LENGTH)


def wrongly_ordered(values: Array) -> Array:
    return values[[3, 8, 0, 10, 5, 1, 11, 7, 2, 9, 4, 6]]


def nonsense(values: Array) -> Array:
    return 300.0 + np.round(2.0 * np.sin(7.3 * np.arange(len(values)) ** 2), 4)


READ_PRS = "read_x_mm read_y_mm read_z_mm read_alpha_deg read_beta_deg"
READ_ANGLES = "read_alpha_deg read_beta_deg read_gamma_deg"
TRACKED = f"read_x_mm read_y_mm read_z_mm {READ_ANGLES}"
