"""Any CSV with commanded poses or joints and readings, by a column map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from oed.base import Array
from oed.dataset import (
    MAX_NUMBER,
    SIGMA,
    ReadingsColumn,
    expected_columns,
    temperature_body,
)
from oed.instrument import Instrument
from oed.mechanism import Kinematics
from oed.model import Machine
from oed.text import suggest
from oed.units import UnitError
from pkm_studies.base import InputError, Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import (
    column_map,
    column_sources,
    nominal_poses,
    orientations,
)
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row
from pkm_studies.importers.line_times import read_tables
from pkm_studies.importers.map_tables import ColumnMap, ColumnSource
from pkm_studies.quantities import column as usual_column
from pkm_studies.quantities import read_values
from pkm_studies.tables import PredictionReference

MAX_LISTED = 10  #: readings that a sentence lists
TEXTS = ("setup", "run")  #: columns of text


class ColumnsImporter:
    """Takes columns by the map, or those whose names are those of a readings file."""

    name = "columns"
    about = "any CSV, by a column map"
    unused = ("--mesh",)

    def read(self, request: ImportRequest) -> ImportedSession:
        """Machine, instrument and columns of the map. Raises InputError."""
        mapping, location = column_map.load(request)
        model = column_map.model(request, mapping, location)
        tool, reference = column_map.instrument(
            request, mapping, location, model.machine
        )
        table = joined(read_tables(request.files))
        columns = mapped_columns(mapping, table, model.machine, tool, location)
        complete = msgspec.structs.replace(
            mapping, machine=model.described, instrument=reference, columns=columns
        )
        read = rows(table, columns, mapping, tool, location)
        placed, left_out = drop_partial_joints(read, model.machine)
        if mapping.orientation is not None:
            nominal_poses.check_orientations(
                placed, mapping, Kinematics(model.machine), tool, table
            )
        return session(
            request,
            complete,
            model,
            tool,
            setups=[setup_table(complete, reference, tool)],
            rows=placed,
            statements=[
                *statements(table, columns, mapping, tool, model.machine),
                *left_out,
            ],
            # a closure read by its joints alone says nothing of the base frame
            errors="best_fit" if _reads_closure(tool, model.machine) else "home",
        )


importer = ColumnsImporter()


def _reads_closure(tool: Instrument, machine: Machine) -> bool:
    """Whether the reading is that of a machine's own constraints."""
    return tool.implied is not None and len(machine.joints) > len(machine.command)


def session(
    request: ImportRequest,
    complete: ColumnMap,
    model: column_map.Model,
    tool: Instrument,
    *,
    setups: Sequence[Mapping[str, object]],
    rows: Sequence[Row],
    statements: Sequence[str],
    errors: PredictionReference = "home",
) -> ImportedSession:
    """The session of a complete map: a study with its set-ups, and what was read."""
    title = f"{model.machine.name} read by {tool.name}"
    return ImportedSession(
        study=column_map.imported_study(
            request, model, title, setups, complete.noise, errors
        ),
        rows=rows,
        statements=statements,
        column_map=column_map.text(complete),
    )


def joined(tables: Sequence[CsvTable]) -> CsvTable:
    """Tables side by side, line by line. Raises InputError where they do not fit."""
    first = tables[0]
    for other in tables[1:]:
        if len(other) != len(first):
            raise InputError(
                f"{len(other)} lines of numbers, but {first.file} has {len(first)}",
                "give files of the same poses in the same order",
                file=other.file,
            )
        repeated = [name for name in other.header if name in first.header]
        nameless = [t.file for t in (first, other) if all(map(str.isdecimal, t.header))]
        if repeated and nameless:
            raise InputError(
                "no names of its columns",
                "write a line of names above the numbers, such as x_mm,y_mm,z_mm for"
                " commands and x,y,z for points",
                file=nameless[-1],
            )
        named = [name for name in repeated if not name.isdecimal()]
        if named:
            problem = f"the column {named[0]} is in {first.file} as well"
            raise InputError(problem, "rename one of them", file=other.file)
        # an index without a name is in the first file already
        columns = [k for k, name in enumerate(other.header) if name not in repeated]
        pairs = zip(first.lines, other.lines, strict=True)
        lines = tuple(
            (number, [*cells, *(more[k] for k in columns)])
            for (number, cells), (_, more) in pairs
        )
        header = (*first.header, *(other.header[k] for k in columns))
        first = CsvTable(first.file, header, lines, first.above)
    return first


def mapped_columns(
    mapping: ColumnMap,
    table: CsvTable,
    machine: Machine,
    tool: Instrument,
    location: Location,
) -> dict[str, str | ColumnSource]:
    """Source in the CSV by column of the readings. Raises InputError.

    What the map does not say is taken where the CSV's name is a readings column.
    """
    unit_of = expected_columns(machine, [tool])
    columns = dict(mapping.columns)
    field = location.key("columns")
    for name, source in column_sources.names(columns).items():
        if not _is_known(name, unit_of):
            possible = [
                ReadingsColumn.of(stem, unit).name for stem, unit in unit_of.items()
            ]
            raise field.key(name).error(
                "no column of readings", suggest(name, possible)
            )
        if source not in table.header:
            remedy = suggest(source, table.header, "the file has")
            raise field.key(name).error("the file has no such column", remedy, source)
    taken = {*column_sources.names(columns).values()}
    taken |= {*orientations.source_columns(mapping.orientation)}
    stems = {ReadingsColumn.stem_of(name) for name in columns}
    for name in table.header:
        is_free = name not in taken and ReadingsColumn.stem_of(name) not in stems
        if is_free and _is_known(name, unit_of):
            columns[name] = name
    channels = {channel.name: channel.unit for channel in tool.channels}
    read_values(mapping.noise, channels, location.key("noise"))
    settings = {setting.name: setting.unit for setting in tool.settings}
    read_values(mapping.settings, settings, location.key("settings"))
    is_read = read_channels(tool, columns) or mapping.orientation is not None
    if not is_read and tool.implied is None:
        channel = tool.channels[0]
        remedy = (
            f"add {usual_column(channel.name, channel.unit)} to [columns] of a --map"
            f" file; the file has {', '.join(table.header)}"
        )
        problem = f"no column for {channel.name}"
        raise InputError(problem, remedy, file=table.file, field="header")
    return columns


def read_channels(
    tool: Instrument, columns: Mapping[str, str | ColumnSource]
) -> list[str]:
    """Channels that the file has, in the instrument's order."""
    stems = {ReadingsColumn.stem_of(name) for name in columns}
    if tool.from_inner is not None:
        # which channels follow shows where absent numbers make none
        raw = {
            name: np.array([1.0 if name in stems else np.nan])
            for name in tool.inner_columns
        }
        values = tool.from_inner(raw, {s.name: 0.0 for s in tool.settings})
        stems |= {name for name, value in values.items() if np.isfinite(value[0])}
    return [channel.name for channel in tool.channels if channel.name in stems]


def _channels(
    tool: Instrument, columns: Mapping[str, str | ColumnSource], mapping: ColumnMap
) -> list[str]:
    """Channels that are read, those of an orientation in another form included."""
    names = set(read_channels(tool, columns))
    if mapping.orientation is not None and tool.orientation is not None:
        stated = tool.orientation
        whole = mapping.orientation.direction is None
        names |= set(stated.names if whole else stated.axis_names)
    return [channel.name for channel in tool.channels if channel.name in names]


def rows(
    table: CsvTable,
    columns: Mapping[str, str | ColumnSource],
    mapping: ColumnMap,
    tool: Instrument,
    location: Location,
) -> list[Row]:
    """Rows of the readings file; cells that are no numbers raise InputError."""
    cells: dict[str, list[str]] = {}
    for name, source in columns.items():
        if name in TEXTS:
            cells[name] = table.cells(column_sources.source_of(source).column)
            continue
        values = column_sources.values(source, table)
        if name.startswith(SIGMA):
            least = column_sources.least_spread(source, table)
            values = np.where(values == 0.0, least, values)
        _check_sizes(values, name, column_sources.source_of(source).column, table)
        cells[name] = ["" if value != value else repr(float(value)) for value in values]
    if mapping.orientation is not None:
        field = location.key("orientation")
        angles = orientations.angle_columns(mapping.orientation, tool, table, field)
        for name in angles:
            if ReadingsColumn.stem_of(name) in {
                ReadingsColumn.stem_of(other) for other in cells
            }:
                problem = f"{name} has a column of its own as well"
                raise field.error(problem, "remove one of the two")
        cells |= angles
    for name, number in mapping.fixed.items():
        cells[name] = [repr(number)] * len(table)
    cells.setdefault("setup", [mapping.setup] * len(table))
    cells.setdefault("run", ["1"] * len(table))
    if "order" not in cells:
        cells["order"] = _order(cells["setup"], cells["run"])
    else:
        cells["order"] = [str(int(float(cell))) for cell in cells["order"]]
    labels = ["setup", "run", "order"]
    names = labels + [name for name in cells if name not in labels]
    return [{name: cells[name][k] for name in names} for k in range(len(table))]


def _check_sizes(values: Array, name: str, column: str, table: CsvTable) -> None:
    """Raises InputError for values (n,) that a readings file could not have."""
    problem = "no number of a session is so large"
    bad = np.abs(values) > MAX_NUMBER
    if name.startswith(SIGMA) and not bad.any():
        problem = "a standard deviation is above 0"
        bad = values <= 0
    if bad.any():
        remedy = "correct the cell, or leave its line out"
        raise table.error(int(np.argmax(bad)), column, problem, remedy)


def drop_partial_joints(
    rows: Sequence[Row], machine: Machine
) -> tuple[list[Row], list[str]]:
    """Rows without those in which some joints are empty; a sentence on these."""
    stems = {joint.name for joint in machine.joints}
    columns = [name for name in rows[0] if ReadingsColumn.stem_of(name) in stems]
    filled = [sum(bool(row[name]) for name in columns) for row in rows]
    partial = [k for k, count in enumerate(filled) if 0 < count < len(columns)]
    complete = [row for k, row in enumerate(rows) if k not in set(partial)]
    if not partial:
        return complete, []
    if not complete:
        raise InputError(
            "no row has all joints",
            "give the joints that the file lacks, or poses in their place",
            file="--map",
            field=columns[0],
        )
    listed = ", ".join(str(k + 1) for k in partial[:MAX_LISTED])
    more = ", ..." if len(partial) > MAX_LISTED else ""
    return complete, [
        f"Left out: {len(partial)} rows in which some joints are empty"
        f" (readings {listed}{more} of the file)."
    ]


def setup_table(
    mapping: ColumnMap, reference: str, tool: Instrument
) -> dict[str, object]:
    """The [[setup]] of a complete map; its channels are those that were read."""
    table: dict[str, object] = {"name": mapping.setup, "instrument": reference}
    channels = _channels(tool, mapping.columns, mapping)
    if 0 < len(channels) < len(tool.channels):
        table["channels"] = channels
    if any(mapping.tool_mm):
        table["tool_mm"] = list(mapping.tool_mm)
    return {**table, **mapping.settings}


def statements(
    table: CsvTable,
    columns: Mapping[str, str | ColumnSource],
    mapping: ColumnMap,
    tool: Instrument,
    machine: Machine,
) -> list[str]:
    """What was taken for what, and what was not taken."""
    taken = ", ".join(map(column_sources.sentence, columns, columns.values()))
    sentences = [f"Readings: {len(table)} lines of {table.file}; {taken}."]
    for name, number in mapping.fixed.items():
        sentences.append(f"All readings: {name} = {number:g}.")
    if mapping.orientation is not None and tool.orientation is not None:
        sentences.append(orientations.statement(mapping.orientation, tool.orientation))
    used = {*column_sources.names(columns).values()}
    used |= {*orientations.source_columns(mapping.orientation)}
    for name in filter(lambda name: name.startswith(SIGMA), columns):
        zeros = int((column_sources.values(columns[name], table) == 0.0).sum())
        if zeros:
            least = column_sources.least_spread(columns[name], table)
            sentences.append(
                f"{name} is 0 in {zeros} lines, as it is rounded: {least:.3g} is taken, of"
                " half its last digit."
            )
    unused = [name for name in table.header if name not in used]
    if unused:
        sentences.append(f"Not used: {', '.join(unused)}.")
    channels = _channels(tool, columns, mapping)
    absent = [c.name for c in tool.channels if c.name not in channels]
    if absent and channels:
        sentences.append(
            f"Not read: {', '.join(absent)}; these channels count nothing."
        )
    elif absent:
        is_closure = _reads_closure(tool, machine)
        source = (
            "the machine's closure" if is_closure else "the poses are the measurement"
        )
        sentences.append(f"The readings are {tool.implied:g}: {source}.")
    return sentences


def _order(setups: Sequence[str], runs: Sequence[str]) -> list[str]:
    count: dict[tuple[str, str], int] = {}
    order = []
    for run in zip(setups, runs, strict=True):
        count[run] = count.get(run, 0) + 1
        order.append(str(count[run]))
    return order


def _is_known(name: str, unit_of: Mapping[str, str]) -> bool:
    """Whether a readings file may have a column of this name."""
    try:
        column = ReadingsColumn.parse(name)
    except UnitError:
        return False
    if column.is_unitless:
        return True
    if temperature_body(column.stem):
        return column.unit == "K"
    return unit_of.get(column.stem) == column.unit
