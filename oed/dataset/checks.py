"""A readings table checked against the machine and its set-ups.

Every check raises ReadingsError for the first problem, with row, column and remedy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index
from oed.dataset.columns import (
    COVARIATES,
    REQUIRED,
    SIGMA,
    column_name,
    column_names,
    is_temperature,
    sigma_units,
    tension_columns,
)
from oed.dataset.notations import notations
from oed.dataset.readings_file import ReadingsError, ReadingsFile
from oed.dataset.table import cell_remedy
from oed.instrument import Setup
from oed.measurement import Measurement
from oed.model import Coordinate
from oed.text import suggest

#: SI amount by which a value may exceed its coordinate's range
RANGE_SLACK = 1e-9
#: other meanings of a column that a remedy names
NAMED = 2
#: names that a remedy lists
LISTED = 24


def expected_columns(measurement: Measurement) -> dict[str, str]:
    """SI unit of every stem that a column may have, temperatures aside."""
    machine = measurement.machine
    expected = {c.name: c.unit for c in (*machine.command, *machine.joints)}
    for setup in measurement.setups.values():
        channels = setup.instrument.channels
        expected |= {c.name: c.unit for c in channels} | sigma_units(channels)
    tensions = dict.fromkeys(tension_columns(machine), "N")
    return {**expected, **COVARIATES, **tensions}


def pose_groups(measurement: Measurement) -> list[list[str]]:
    """Stems that only together give a pose: the commands, and the joints."""
    machine = measurement.machine
    return [[c.name for c in machine.command], [c.name for c in machine.joints]]


def check_columns(table: ReadingsFile, measurement: Measurement) -> None:
    """Refuse columns that are unknown, or in a unit of another kind."""
    expected = expected_columns(measurement)
    for stem, column in table.columns.items():
        if stem in REQUIRED:
            continue
        unit = "K" if is_temperature(stem) else expected.get(stem)
        if unit is None:
            names = [column_name(n, u) for n, u in expected.items()]
            names.append("temp_<body>_C")
            problem, remedy = (
                "unknown column",
                suggest(column.name, names, "known", LISTED),
            )
        elif column.unit != unit:
            names = column_names(stem, unit) or [column_name(stem, unit)]
            problem, remedy = "the unit does not fit", f"write {', '.join(names)}"
        else:
            continue
        raise ReadingsError(problem, remedy, file=table.file, row=1, column=column.name)


def check_setups(table: ReadingsFile, measurement: Measurement) -> None:
    """Refuse rows of unknown set-ups, and readings that an instrument does not take."""
    setups = measurement.setups
    names = table.frame["setup"]
    for at in np.flatnonzero(~names.isin(setups).to_numpy())[:1]:
        remedy = suggest(names[at], setups, "known", LISTED)
        raise table.error("no such set-up", remedy, int(at), "setup")
    channels = {c.name for s in setups.values() for c in s.instrument.channels}
    for name, setup in setups.items():
        rows = np.flatnonzero((names == name).to_numpy())
        if rows.size:
            _check_channels(table, setup, rows, channels)


def _check_channels(
    table: ReadingsFile, setup: Setup, rows: Index, channels: set[str]
) -> None:
    """Check the rows of one set-up; `channels` are those of all set-ups."""
    stems = [c.name for c in setup.instrument.channels]
    for channel in setup.instrument.channels:
        implied = setup.instrument.implied is not None
        if channel.name not in table.columns and not implied:
            column = column_name(channel.name, channel.unit)
            problem = f"{setup.name} reads {channel.name}, which has no column"
            remedy = f"add {column}, or give the set-up the channels that were read"
            raise table.error(problem, remedy, int(rows[0]), column)
    others = channels - set(stems)
    others |= {f"{SIGMA}{name}" for name in others}
    for other in sorted(others & set(table.columns)):
        values = table.frame[other].to_numpy()[rows]
        for at in rows[np.isfinite(values)][:1]:
            reads = f"{setup.name} ({setup.instrument.name}) reads {', '.join(stems)}"
            remedy = "leave this cell empty, or correct the set-up"
            raise table.error(reads, remedy, int(at), other)


def check_range(
    table: ReadingsFile,
    coordinates: Sequence[Coordinate],
    values: Array,
    rows: Index,
    name: str,
) -> None:
    """Refuse values (n, k) of table rows (n,) outside the range called `name`."""
    for k, coordinate in enumerate(coordinates):
        lower, upper = coordinate.lower, coordinate.upper
        below = values[:, k] < lower - RANGE_SLACK
        above = values[:, k] > upper + RANGE_SLACK
        for i in np.flatnonzero(below | above)[:1]:
            factor = table.columns[coordinate.name].factor
            remedy = (
                f"{coordinate.name} goes from {lower / factor:.6g} to"
                f" {upper / factor:.6g} in this column's unit"
                f"{_other_meaning(table, coordinate, values[:, k])}"
            )
            raise table.error(
                f"outside the {name}", remedy, int(rows[i]), coordinate.name
            )


def _other_meaning(table: ReadingsFile, coordinate: Coordinate, values: Array) -> str:
    """Other meanings of a column, with which all its values are in the range, in words."""
    lower, upper = coordinate.lower - RANGE_SLACK, coordinate.upper + RANGE_SLACK
    name = table.columns[coordinate.name].name
    fitting = [
        words.format(name)
        for words, meant in notations(coordinate, values).items()
        if ((lower <= meant(values)) & (meant(values) <= upper)).all()
    ]
    return f". All fit if {', or if '.join(fitting[:NAMED])}" if fitting else ""


def filled_columns(
    table: ReadingsFile, stems: Sequence[str], rows: Index
) -> Array | None:
    """Columns (n, k) of table rows (n,); None where all are empty.

    Raises ReadingsError where only some are filled.
    """
    present = [stem for stem in stems if stem in table.columns]
    values: Array = table.frame.loc[rows, present].to_numpy(dtype=float)
    finite = np.isfinite(values)
    if not finite.any():
        return None
    wanted = cell_remedy(stems[0], [stems])
    if len(present) < len(stems):
        absent = next(stem for stem in stems if stem not in present)
        problem = f"there is no column for {absent}"
        raise table.error(problem, wanted, int(rows[0]), absent)
    for i, k in np.argwhere(~finite)[:1]:
        raise table.error("the cell is empty", wanted, int(rows[i]), present[k])
    return values
