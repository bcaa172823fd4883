"""Points of a laser tracker or a CMM: commanded poses, and the tool in a frame of its own.

The instrument's frame is laid onto the machine's by a best fit of the points to where the
nominal machine would be: s_i = R m_i + t with the least sum of squares (Kabsch). Then the
frame is free within tolerances, or held there.

Read are the forms that files of trackers are known to have: X [mm] and U(95) X [mm] of
Hexagon's tracker software, with a unit each, and SpatialAnalyzer's names of the columns in
a comment, without one; of motion capture Position over X with Motive's Length Units, TX over
mm, and Qualisys's names of markers above the numbers. Points without
a unit are taken for millimetres, which their best fit to the machine confirms or refuses.
Everything else needs a map.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from oed import units
from oed.base import Array
from oed.dataset import SIGMA
from oed.instrument import Instrument
from oed.mechanism import NO_TOOL, Kinematics
from pkm_studies.base import InputError, Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import (
    column_map,
    column_sources,
    columns,
    nominal_poses,
    orientations,
)
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row, line_field
from pkm_studies.importers.line_times import read_tables
from pkm_studies.importers.map_tables import ColumnMap, ColumnSource

INSTRUMENT = "pose_tracker_position"
#: tolerances of a frame that is only known by the best fit
FREE = {
    **{f"shift_{axis}_mm": 10.0 for axis in "xyz"},
    **{f"turn_{axis}_mrad": 20.0 for axis in "xyz"},
}
#: rms of the best fit over the points' spread above which the points are no such poses
WORST_FIT = 0.1
#: how many times better a mirrored frame must fit to be named
MIN_MIRROR_FIT_RATIO = 5.0
CHANNELS = ("read_x", "read_y", "read_z")
UNIT = r"(?:[\[(]\s*(?P<unit>mm|m|in|um)\s*[\])])"
#: measured coordinates: X, x [mm], x_meas, Position X, TX [mm]
MEASURED = re.compile(
    rf"\s*(?:position\s+|meas(?:ured)?[ ._]+|t)?(?P<axis>[xyz])\s*(?:{UNIT}|_?meas(?:ured)?|_?m)?\s*",
    re.IGNORECASE,
)
#: expanded uncertainty of a coordinate, of coverage 95 %
U95 = re.compile(rf"\s*U\(95\)\s*(?P<axis>[xyz])\s*{UNIT}\s*", re.IGNORECASE)
COVERAGE_FACTOR = 2.0
#: columns that may be a standard deviation, or k times that
UNCERTAINTY = re.compile(
    r"\s*(?:u|u95|std|stdev|sigma|sd|unc|uncertainty)[ _.]*[(]?[xyz]\b.*", re.IGNORECASE
)
DELETED = "Delete"
#: the cell before the unit of a Motive file, and its units
LENGTH_UNITS = "Length Units"
UNIT_WORDS = {"millimeters": "mm", "meters": "m", "inches": "in"}
#: the cells before the names of markers or bodies of a Qualisys file
NAMES = ("MARKER_NAMES", "BODY_NAMES")


class BestFit(NamedTuple):
    """Rotation and shift (3,), m, of the instrument's frame, and the rms left, m."""

    rotation: Rotation
    shift: Array
    rms: float

    def apply(self, points: Array) -> Array:
        """Points (n, 3) of the instrument's frame in the machine's."""
        return np.asarray(self.rotation.apply(points) + self.shift)


class TrackerImporter:
    """Takes points with x, y, z from one file, and poses from it or from a second."""

    name = "tracker"
    about = "tracker or CMM points (CSV), with their frame laid onto the machine's"
    unused = ("--mesh",)

    def read(self, request: ImportRequest) -> ImportedSession:
        """Poses and points, in the machine's frame. Raises InputError."""
        mapping, location = column_map.load(request)
        model = column_map.model(request, mapping, location)
        tool, reference = column_map.instrument(
            request, mapping, location, model.machine, INSTRUMENT
        )
        table = columns.joined(list(map(named_markers, read_tables(request.files))))
        mapping = msgspec.structs.replace(mapping, columns=add_measured(mapping, table))
        mapped = columns.mapped_columns(mapping, table, model.machine, tool, location)
        complete = msgspec.structs.replace(
            mapping, machine=model.described, instrument=reference, columns=mapped
        )
        rows = columns.rows(table, mapped, mapping, tool, location)
        rows, left_out = columns.drop_partial_joints(rows, model.machine)
        kinematics = Kinematics(model.machine)
        rows = target_rows(rows, mapping, kinematics, location)
        rows, sentence = _registered(rows, mapping, kinematics, tool, table, location)
        rows, channels = split_by_channels(rows, tool)
        return columns.session(
            request,
            complete,
            model,
            tool,
            setups=_setups(complete, reference, tool, channels),
            rows=rows,
            statements=[
                *columns.statements(table, mapped, mapping, tool, model.machine),
                *uncertainty_sentences(table, mapped),
                *left_out,
                *sentence,
            ],
            errors="home" if mapping.registration == "known" else "best_fit",
        )


importer = TrackerImporter()


def best_fit(measured: Array, wanted: Array) -> BestFit:
    """The rigid motion that lays measured points (n, 3) best onto wanted ones, m."""
    middle, target = measured.mean(axis=0), wanted.mean(axis=0)
    rotation, _ = Rotation.align_vectors(wanted - target, measured - middle)
    shift = target - rotation.apply(middle)
    residual = rotation.apply(measured) + shift - wanted
    return BestFit(rotation, shift, math.sqrt(float(np.mean(residual**2))))


def _registered(
    rows: list[Row],
    mapping: ColumnMap,
    kinematics: Kinematics,
    tool: Instrument,
    table: CsvTable,
    location: Location,
) -> tuple[list[Row], list[str]]:
    """Rows with readings in the machine's frame; what was done. Raises InputError."""
    if mapping.registration == "known":
        nominal_poses.check_orientations(rows, mapping, kinematics, tool, table)
        return rows, ["Frame: the points are taken to be in the machine's frame."]
    angles = _orientation_columns(rows, tool, location)
    names = [nominal_poses.channel_column(rows, channel) for channel in CHANNELS]
    measured = nominal_poses.si_numbers(rows, names)
    _, wanted = nominal_poses.nominal_frames(rows, kinematics, mapping)
    used = np.isfinite(measured).all(axis=1) & np.isfinite(wanted).all(axis=1)
    if used.sum() < 4:
        raise InputError(
            f"{int(used.sum())} points are too few to find the instrument's frame",
            'measure four poses or more, or state registration = "known" in the map',
            file=table.file,
        )
    fit = best_fit(measured[used], wanted[used])
    _check_fit(fit, measured[used], wanted[used], table)
    moved = fit.apply(measured)
    changed: list[Row] = []
    for k, row in enumerate(rows):
        cells = {
            name: repr(float(value / units.factor(name.rpartition("_")[2])))
            for name, value in zip(names, moved[k], strict=True)
            if np.isfinite(value)
        }
        changed.append({**row, **cells, **_turned_sigma(row, fit.rotation)})
    nominal_poses.check_orientations(
        rows, mapping, kinematics, tool, table, fit.rotation
    )
    if angles and tool.orientation is not None:
        changed = orientations.rotate_rows(
            changed, angles, tool.orientation, fit.rotation
        )
    return changed, _frame_sentences(fit, mapping)


def _turned_sigma(row: Row, by: Rotation) -> dict[str, str]:
    """Cells of a reading's standard deviations in the turned frame.

    Those of the turned coordinates; where they differ, correlations are left out.
    """
    stems = {name.rpartition("_")[0]: name for name in row}
    columns = [stems.get(f"{SIGMA}{channel}", "") for channel in CHANNELS]
    if not all(column and row[column] for column in columns):
        return {}
    factors = np.array([units.factor(c.rpartition("_")[2]) for c in columns])
    variance = (factors * np.array([float(row[c]) for c in columns])) ** 2
    sigma = np.sqrt(by.as_matrix() ** 2 @ variance) / factors
    return {c: f"{v:.9g}" for c, v in zip(columns, sigma, strict=True)}


def _orientation_columns(
    rows: list[Row], tool: Instrument, location: Location
) -> dict[str, str]:
    """Columns of the angles that can be turned with the frame. Raises InputError."""
    read = [name for name in rows[0] if name.startswith("read_")]
    others = [name for name in read if not name.startswith(CHANNELS)]
    by_stem = {name.rpartition("_")[0]: name for name in others}
    stated = tool.orientation
    axis = () if stated is None else stated.axis_names
    complete = stated is not None and set(by_stem) <= set(stated.names)
    if others and not (complete and set(axis) <= set(by_stem)):
        raise location.key("registration").error(
            f"{others[0]} would stay in the instrument's frame",
            'turn the points beforehand and state registration = "known"',
        )
    return by_stem


def _check_fit(fit: BestFit, measured: Array, wanted: Array, table: CsvTable) -> None:
    """Raises InputError for points in a left-handed frame, or of other poses."""
    spread = math.sqrt(float(np.mean((wanted - wanted.mean(axis=0)) ** 2)))
    if fit.rms < WORST_FIT * spread:
        return
    mirrored = best_fit(measured * np.array([1.0, 1.0, -1.0]), wanted)
    if MIN_MIRROR_FIT_RATIO * mirrored.rms < fit.rms:
        raise InputError(
            "the points fit their mirror image: the instrument's frame is left-handed,"
            " or two axes are swapped",
            "swap two of read_x, read_y, read_z in [columns] of the map",
            file=table.file,
        )
    rms = units.number(fit.rms, "mm")
    raise InputError(
        f"the points are {rms:.3g} mm rms off the commanded poses after a best fit",
        "check that points and poses are in one order, their units, and the machine",
        file=table.file,
    )


def _frame_sentences(fit: BestFit, mapping: ColumnMap) -> list[str]:
    shift = ", ".join(f"{v:.6g}" for v in units.from_si(fit.shift, "mm"))
    vector = units.from_si(fit.rotation.as_rotvec(), "deg")
    turn = ", ".join(f"{v:.5g}" for v in vector)
    rms = units.number(fit.rms, "mm")
    role = "free within 10 mm and 20 mrad, and identified with the machine"
    if mapping.registration == "best_fit":
        role = "held there: what the machine's errors share with a rigid motion is lost"
    return [
        f"Frame: best fit to the nominal poses, shift {shift} mm, rotation vector"
        f" {turn} deg; {rms:.3g} mm rms are left.",
        f"The frame is {role}.",
    ]


def _setups(
    mapping: ColumnMap,
    reference: str,
    tool: Instrument,
    channels: Mapping[str, Sequence[str]],
) -> list[dict[str, object]]:
    """The [[setup]] tables, by set-up the channels that it read; they share the frame."""
    tolerance = (
        dict(FREE) if mapping.registration == "free" else dict.fromkeys(FREE, 0.0)
    )
    tables = []
    for name, read in channels.items():
        table: dict[str, object] = {"name": name, "instrument": reference}
        tool_mm = units.from_si(tool_of(name, mapping), "mm").tolist()
        table |= {"tolerance": tolerance, **mapping.settings}
        if len(read) < len(tool.channels):
            table["channels"] = list(read)
        if any(tool_mm):
            table["tool_mm"] = tool_mm
        if len(channels) > 1:
            table["station"] = STATION
        tables.append(table)
    return tables


# -- columns that a header explains ----------------------------------------------------
def named_markers(table: CsvTable) -> CsvTable:
    """The table with plain names of a single Qualisys marker's or body's columns."""
    rows = [cells for _, cells in table.above if cells and cells[0] in NAMES]
    names = [name for name in rows[0][1:] if name] if rows else []
    header = list(table.header)
    first = len(header) - 3 * len(names)
    if names and first >= 0 and header == [str(k + 1) for k in range(len(header))]:
        header[first:] = [f"{name} {axis}" for name in names for axis in "XYZ"]
    if len(names) == 1:
        header = [name.removeprefix(f"{names[0]} ") for name in header]
    return dataclasses.replace(table, header=tuple(header))


def stated_unit(table: CsvTable) -> str:
    """The unit of lengths above the header, mm without one. Raises InputError."""
    for number, cells in table.above:
        if LENGTH_UNITS in cells[:-1]:
            word = cells[cells.index(LENGTH_UNITS) + 1]
            if word.lower() not in UNIT_WORDS:
                raise InputError(
                    "no unit that is read",
                    f"export in one of {', '.join(UNIT_WORDS)}, or write a map",
                    file=table.file,
                    field=line_field(number, LENGTH_UNITS),
                    value=word,
                )
            return UNIT_WORDS[word.lower()]
    return "mm"


def add_measured(mapping: ColumnMap, table: CsvTable) -> dict[str, str | ColumnSource]:
    """The map's columns, with the points of the file where it names none.

    Raises InputError where two columns may be a coordinate, and for points that the
    tracker's user deleted.
    """
    mapped: dict[str, str | ColumnSource] = dict(mapping.columns)
    if any(name.startswith(CHANNELS) for name in [*mapped, *table.header]):
        return mapped
    _check_deleted(table)
    others = set(column_sources.names(mapped).values())
    axes: dict[str, str] = {}
    unit = stated_unit(table)
    for header in [name for name in table.header if name not in others]:
        match, spread = MEASURED.fullmatch(header), U95.fullmatch(header)
        if match:
            axis = match["axis"].lower()
            _check_alone(table, axis, header, axes)
            mapped[f"read_{axis}_{_unit(match, unit)}"] = axes[axis] = header
        if spread:
            name = f"sigma_read_{spread['axis'].lower()}_{_unit(spread, unit)}"
            mapped[name] = ColumnSource(column=header, k=COVERAGE_FACTOR)
    return mapped


def uncertainty_sentences(
    table: CsvTable, mapped: dict[str, str | ColumnSource]
) -> list[str]:
    """What is not known of columns that may be uncertainties."""
    used = column_sources.names(mapped).values()
    unsure = [n for n in table.header if UNCERTAINTY.fullmatch(n) and n not in used]
    if not unsure:
        return []
    return [
        f"Not read, for want of a coverage factor: {', '.join(unsure)}. A map says it:"
        f' sigma_read_x_mm = {{ column = "{unsure[0]}", k = 2 }} for U95.'
    ]


def _unit(match: re.Match[str], unit: str) -> str:
    return (match["unit"] or unit).lower()


def _check_alone(table: CsvTable, axis: str, header: str, axes: dict[str, str]) -> None:
    if axis in axes:
        raise InputError(
            f"{axes[axis]} and {header} may both be the measured {axis}",
            f"write a map that names one: [columns] read_{axis}_mm",
            file=table.file,
            field="header",
        )


def _check_deleted(table: CsvTable) -> None:
    """Raises InputError for a line that the tracker's user marked as deleted."""
    if DELETED not in table.header:
        return
    for k, cell in enumerate(table.cells(DELETED)):
        if cell.lower() not in ("", "false", "0"):
            remedy = "take the line out, or write a map that names the columns"
            raise table.error(k, DELETED, "the point was deleted", remedy)


# Several targets of one tracker: set-ups of one station, with what each of them read.
#
# A map's [targets] has the place of each on the platform, by its name in the column `setup`.
# Commands of a file are those of the machine's own tool point; a set-up's are those of its
# target. Readings of a target without its orientation are a set-up of their own, so that an
# orientation that was not measured stays out and costs no point.

STATION = "tracker"
POINTS = "_points"  #: end of the name of a target's readings without orientation


def target_rows(
    rows: Sequence[Row], mapping: ColumnMap, kinematics: Kinematics, location: Location
) -> list[Row]:
    """Rows whose commands are those of targets of the map. Raises InputError."""
    if not mapping.targets:
        return list(rows)
    moved = [dict(row) for row in rows]
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    columns = [stems.get(c.name, "") for c in kinematics.machine.command]
    for target, members in nominal_poses.members_by_setup(rows).items():
        if target not in mapping.targets:
            remedy = f"give its place on the platform: {target} = [x, y, z]"
            raise location.key("targets").error("no such target", remedy, target)
        if not all(columns):
            continue  # joints were recorded
        command = nominal_poses.si_numbers([rows[k] for k in members], columns)
        tool = units.to_si(np.array(mapping.targets[target]), "mm")
        pose = kinematics.inverse(command, None, NO_TOOL)[0]
        start = kinematics.machine.with_tool(command, tool)
        command = kinematics.command_of_pose(pose, start, tool)
        for k, values in zip(members, command, strict=True):
            for name, value in zip(columns, values, strict=True):
                unit = name.rpartition("_")[2]
                moved[k][name] = repr(units.number(float(value), unit))
    return list(moved)


def split_by_channels(
    rows: Sequence[Row], tool: Instrument
) -> tuple[list[Row], dict[str, list[str]]]:
    """Rows, those without some channels in a set-up of their own; channels by set-up."""
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    columns = {c.name: stems[c.name] for c in tool.channels if c.name in stems}
    read_by_row = [[n for n, column in columns.items() if row[column]] for row in rows]
    channels: dict[str, list[str]] = {}
    for name, members in nominal_poses.members_by_setup(rows).items():
        channels[name] = max((read_by_row[k] for k in members), key=len)
    split: list[Row] = []
    for row, read in zip(rows, read_by_row, strict=True):
        name = row["setup"]
        if read and channels[name] != read:
            name = f"{name}{POINTS}"
            if channels.setdefault(name, read) != read:
                raise InputError(
                    f"{row['setup']} has readings of more than two sets of channels",
                    "leave out rows in which a coordinate or an angle is missing alone",
                    file="--map",
                    field="columns",
                )
        split.append({**row, "setup": name})
    return split, channels


def tool_of(setup: str, mapping: ColumnMap) -> Array:
    """The tool point (3,) of a set-up, m."""
    tool_mm = mapping.targets.get(setup.removesuffix(POINTS), mapping.tool_mm)
    return np.asarray(units.to_si(np.array(tool_mm), "mm"))
