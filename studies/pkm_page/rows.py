"""Rows of a readings file for one reading at a pose: labels, command, values, time."""

import csv
import dataclasses
import datetime
import io
import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from oed import dataset
from oed.base import Array
from oed.dataset import ReadingsColumn, commented
from oed.measurement import Measurement, Series
from oed.model import Coordinate
from pkm_page.readings_log import REMARK, UNDONE, FileContent
from pkm_studies.base import InputError
from pkm_studies.resolve import PASS_SUFFIX
from pkm_studies.sessions import SkippedPose

SKIPPED_RUN = "skipped"  #: run of a skipped pose that is relative to a reference
#: decimals of a command, mm or deg: those that a controller takes
COMMAND_DECIMALS: Final = 4
MAX_REMARK_LENGTH: Final = 200  #: characters of a remark
TIME: Final = "time_s"
STARTED: Final = "time_s counts from"  #: the comment that says when time_s is zero
_STARTED: Final = re.compile(rf"# {STARTED} (\S+)")


def sent_cells(measurement: Measurement, series: Series, row: int) -> Series:
    """The reading of a series' row alone, at commands of `DECIMALS` decimals.

    What is shown, driven to and written is then one pose. Raises AssemblyError.
    """
    one = series.take(np.array([row]))
    run = PASS_SUFFIX.sub("", str(one.run[0]))  # `direction` tells passes apart
    one = dataclasses.replace(one, run=np.array([run] * len(one), dtype=np.str_))
    if np.isnan(one.command).any():
        return one
    setup = measurement.setups[series.setup]
    poses = list(one.index[0])
    if setup.instrument.reference == "run":
        poses.reverse()  # the reference is the first pose of its run
    elif setup.teach is not None:
        poses = poses[:1]
    coordinates = measurement.machine.workspace(setup.tool)
    command = np.array(
        [
            [_rounded(v, c) for v, c in zip(one.command[k], coordinates, strict=True)]
            for k in poses
        ]
    )
    sent = measurement.series(series.setup, command, [run] * len(command))
    return sent.take(np.array([0]))


def _rounded(value: float, coordinate: Coordinate) -> float:
    """A command with `DECIMALS` decimals in the unit of its column, within its range."""
    factor = ReadingsColumn.of(coordinate.name, coordinate.unit).factor
    step = 10.0**-COMMAND_DECIMALS
    number = round(value / factor, COMMAND_DECIMALS)
    if number * factor > coordinate.upper:
        number = round(number - step, COMMAND_DECIMALS)
    elif number * factor < coordinate.lower:
        number = round(number + step, COMMAND_DECIMALS)
    return number * factor


def entry_columns(measurement: Measurement, setup: str) -> list[Coordinate]:
    """What a person enters for a reading: the channels, or joints that are recorded."""
    mounted = measurement.setups[setup]
    if mounted.instrument.implied is not None:
        return list(measurement.machine.joints)
    return [Coordinate(c.name, c.unit) for c in mounted.instrument.channels]


def reading_rows(
    measurement: Measurement, one: Series, values: Sequence[float], content: FileContent
) -> list[dict[str, str]]:
    """Rows for a series of one reading; values in the units of its columns.

    A reading that is relative to a reference of its run has the reference's row before
    it, unless a run of the file begins at that pose.
    """
    setup = measurement.setups[one.setup]
    empty = np.full(len(setup.instrument.channels), np.nan)
    planned = dataset.to_csv(dataset.from_series([one], empty, measurement))
    rows = list(csv.DictReader(io.StringIO(planned, newline="")))
    columns = entry_columns(measurement, one.setup)
    for c, value in zip(columns, values, strict=True):
        rows[-1][ReadingsColumn.of(c.name, c.unit).name] = f"{value:.15g}"
    if len(rows) == 1:
        return [rows[0] | {"order": str(_next_order(content, rows[0]))}]
    run = _run_from(content, rows[0])
    if run is not None:
        reading = rows[1] | {"run": run}
        return [reading | {"order": str(_next_order(content, reading))}]
    label = _free_run(content, rows[0])
    reference = {k: v for k, v in rows[0].items() if v}
    return [
        reference | {"run": label, "order": "1"},
        rows[1] | {"run": label, "order": "2"},
    ]


def needs_reference(
    content: FileContent, series: Series, measurement: Measurement
) -> bool:
    """Whether the instrument is to be zeroed at the reference before a reading."""
    empty = [0.0] * len(entry_columns(measurement, series.setup))
    return len(reading_rows(measurement, series, empty, content)) > 1


def last_reading(content: FileContent, measurement: Measurement) -> int | None:
    """The last row of the table (from 1) that has a reading; None where none has."""
    for k in range(len(content.rows) - 1, 0, -1):
        if reading_cells(content, k, measurement):
            return k
    return None


def reading_cells(
    content: FileContent, row: int, measurement: Measurement
) -> dict[str, str]:
    """The cells of a row that hold its reading, by column; none where it has none."""
    cells = content.cells(row)
    setup = cells.get("setup", "").strip()
    if setup not in measurement.setups:
        return {}
    stems = {c.name for c in entry_columns(measurement, setup)}
    filled = {name: cell for name, cell in cells.items() if cell.strip()}
    return {
        name: cell
        for name, cell in filled.items()
        if ReadingsColumn.stem_of(name) in stems
    }


def mark_undone(
    content: FileContent, row: int, measurement: Measurement
) -> FileContent:
    """The content with a row's reading moved into its remark."""
    values = reading_cells(content, row, measurement)
    phrase = ", ".join(f"{name} = {value}" for name, value in values.items())
    before = content.cells(row).get(REMARK, "")
    remark = "; ".join(part for part in (before, f"{UNDONE}: {phrase}") if part)
    return content.replace_cells(row, {**dict.fromkeys(values, ""), REMARK: remark})


def skipped_rows(
    measurement: Measurement, series: Series, content: FileContent, reason: str
) -> list[dict[str, str]]:
    """Rows for a skipped pose, without a value; a relative one is a run of its own."""
    columns = entry_columns(measurement, series.setup)
    fresh = dataclasses.replace(content, rows=())
    new = reading_rows(measurement, series, [0.0] * len(columns), fresh)
    names = {ReadingsColumn.of(c.name, c.unit).name for c in columns}
    new[-1] |= dict.fromkeys(names, "")
    cleaned = clean_remark(reason)
    new[-1][REMARK] = SkippedPose.remark(cleaned)
    if len(new) == 1:
        return [new[0] | {"order": str(_next_order(content, new[0]))}]
    run = _free_run(content, new[0] | {"run": SKIPPED_RUN})
    return [one | {"run": run} for one in new]


def skipped(content: FileContent, measurement: Measurement) -> list[int]:
    """Rows of the table whose pose is skipped."""
    rows = range(1, len(content.rows))
    return [k for k in rows if SkippedPose.is_in(content.cells(k), measurement)]


def remove_skip(content: FileContent, row: int) -> FileContent:
    """The content with a skipped row's pose advised again."""
    before = content.cells(row)[REMARK]
    return content.replace_cells(row, {REMARK: f"advised again, was {before}"})


def clean_remark(text: str) -> str:
    """A remark on one line, printable. Raises InputError where it is too long."""
    printable = "".join(c if c.isprintable() else " " for c in text)
    line = " ".join(printable.split())
    if len(line) > MAX_REMARK_LENGTH:
        problem = f"{len(line)} characters are too many for a remark"
        raise InputError(problem, f"write {MAX_REMARK_LENGTH} at most", field=REMARK)
    return line


def add_clock(content: FileContent, measurement: Measurement) -> FileContent:
    """With a comment that starts the session's clock, where nothing was read before."""
    fresh = last_reading(content, measurement) is None and TIME not in content.header
    if not fresh or _STARTED.search(content.above):
        return content
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    above = content.above + commented([f"{STARTED} {now}"])
    return FileContent(content.version, above, content.separator, content.rows)


def time_cell(content: FileContent) -> Mapping[str, str]:
    """The time of a reading that is taken now; nothing where no clock was started."""
    started = _STARTED.search(content.above)
    if started is None:
        return {}
    try:
        zero = datetime.datetime.fromisoformat(started[1])
    except ValueError:
        return {}
    seconds = (datetime.datetime.now(datetime.UTC) - zero).total_seconds()
    return {TIME: f"{max(seconds, 0.0):.1f}"}


def times(content: FileContent) -> Array:
    """Times (n,) of all rows that have one, s, ascending."""
    cells = [content.cells(k).get(TIME, "") for k in range(1, len(content.rows))]
    values = [float(cell.replace(",", ".")) for cell in cells if _is_number(cell)]
    return np.sort(np.array(values))


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"\d+([.,]\d+)?", cell.strip()) is not None


def _labels(content: FileContent, k: int) -> tuple[str, str]:
    cells = content.cells(k)
    return cells.get("setup", "").strip(), cells.get("run", "").strip()


def _next_order(content: FileContent, row: Mapping[str, str]) -> int:
    """The order after the last one of a row's run."""
    label = (row["setup"], row["run"])
    rows = [k for k in range(1, len(content.rows)) if _labels(content, k) == label]
    orders = [content.cells(k).get("order", "") for k in rows]
    return 1 + max((int(o) for o in orders if o.strip().isdigit()), default=0)


def _run_from(content: FileContent, reference: Mapping[str, str]) -> str | None:
    pose = {
        ReadingsColumn.stem_of(name): float(cell) * ReadingsColumn.parse(name).factor
        for name, cell in reference.items()
        if cell and name not in ("setup", "run", "order")
    }
    begun: set[tuple[str, str]] = set()
    for k in range(1, len(content.rows)):
        label = _labels(content, k)
        if label[0] != reference["setup"] or label in begun:
            continue
        if label[1].startswith(SKIPPED_RUN):  # nobody has zeroed the instrument there
            continue
        begun.add(label)
        if _is_at(content.cells(k), pose):
            return label[1]
    return None


def _is_at(cells: Mapping[str, str], pose: Mapping[str, float]) -> bool:
    values = {}
    for name, cell in cells.items():
        if ReadingsColumn.stem_of(name) in pose and cell.strip():
            number = float(cell.replace(",", "."))
            values[ReadingsColumn.stem_of(name)] = (
                number * ReadingsColumn.parse(name).factor
            )
    return values.keys() == pose.keys() and all(
        abs(values[stem] - value) < 1e-9 for stem, value in pose.items()
    )


def _free_run(content: FileContent, row: Mapping[str, str]) -> str:
    used = {_labels(content, k) for k in range(1, len(content.rows))}
    name = row["run"]
    number = 1
    while (row["setup"], name) in used:
        number += 1
        name = f"{row['run']} ({number})"
    return name
