"""Ball-bar traces: deviation of the bar's length against angle, or against time.

One file has one run or several; a run ends where the angle turns back, which is how a
forward and a backward circle follow each other in one file. Deviations are added to the
bar's length. The map's table [circle] says where the circle was.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from oed import units
from oed.arrays import Array
from oed.kinematics import Kinematics
from pkm_studies import csv_table
from pkm_studies.csv_table import CsvTable
from pkm_studies.errors import Place
from pkm_studies.importers import column_map
from pkm_studies.importers.base import (
    ImportedSession,
    ImportRequest,
    Row,
)
from pkm_studies.importers.column_map import Model
from pkm_studies.importers.thinning import Thinned, thin
from pkm_studies.resolve.poses import PLANES
from pkm_studies.resolve.quantities import column as usual_column
from pkm_studies.resolve.quantities import read_values
from pkm_studies.resolve.tool_points import ToolPoints
from pkm_studies.study.tables.column_map import CircleFacts, ColumnMap

INSTRUMENT = "ball_bar_free_cup"
#: columns of a trace, with their SI units
QUANTITIES = {"angle": "rad", "time": "s", "deviation": "m"}
#: words by which a column without a map is recognised, and its unit where none is named
WORDS = {
    "angle": (("angle", "winkel", "theta"), "deg"),
    "time": (("time", "zeit"), "s"),
    "deviation": (("deviation", "error", "abweichung"), "um"),
}
#: an angle that goes back by less is jitter, deg
JITTER = 1.0
#: largest deviation that is no mistake in the unit, over the radius
LARGEST = 0.05
FEWEST = 8


class BarTrace(NamedTuple):
    """A run: angle (n,) rad, deviation (n,) m, time (n,) s or NaN."""

    angle: Array
    deviation: Array
    time: Array

    @property
    def direction(self) -> int:
        """+1 counter-clockwise, -1 clockwise."""
        return 1 if self.angle[-1] > self.angle[0] else -1


class BallbarImporter:
    """Takes traces, thins them, and puts their points on the machine's circle."""

    name = "ballbar"
    about = "ball-bar traces (CSV): angle or time against deviation, both directions"

    def read(self, request: ImportRequest) -> ImportedSession:
        """All runs of all files. Raises InputError."""
        given, place = column_map.load(request)
        model = column_map.model(request, given, place)
        circle = given.circle
        if circle is None:
            raise place.key("circle").error(
                "missing",
                "give a --map file with [circle] centre_mm = [x, y, z] and radius_mm",
            )
        tables = [csv_table.read(path) for path in request.files]
        columns = _columns(given, tables[0], place)
        traces = [
            trace for table in tables for trace in _traces(table, columns, circle)
        ]
        thinned = [thin(*trace, circle.readings) for trace in traces]
        complete = msgspec.structs.replace(
            given, machine=model.described, instrument=INSTRUMENT, columns=columns
        )
        return ImportedSession(
            study=_study(request, complete, circle, model, thinned),
            rows=_rows(traces, thinned, complete, circle, model, place),
            statements=_statements(traces, thinned, columns, circle),
            column_map=column_map.text(complete),
        )


importer = BallbarImporter()


# -- traces ----------------------------------------------------------------------------


def _columns(given: ColumnMap, table: CsvTable, place: Place) -> dict[str, str]:
    """Column of the CSV by quantity with unit. Raises InputError."""
    columns = dict(given.columns)
    for name, source in columns.items():
        read_values({name: 0.0}, QUANTITIES, place.key("columns"))
        if source not in table.header:
            at, remedy = place.key("columns").key(name), ", ".join(table.header)
            problem = "the file has no such column"
            raise at.error(problem, f"the file has {remedy}", source)
    stems = {name.rpartition("_")[0] for name in columns}
    for quantity, (words, unit) in WORDS.items():
        for header in table.header:
            if quantity not in stems and any(w in header.lower() for w in words):
                columns[f"{quantity}_{_unit_in(header, quantity) or unit}"] = header
                stems.add(quantity)
    _check_single(columns, given, table, place)
    for wanted in (("deviation",), ("angle", "time")):
        if not stems & set(wanted):
            name = usual_column(wanted[0], QUANTITIES[wanted[0]])
            raise place.key("columns").error(
                f"no column for {' or '.join(wanted)}",
                f"add {name} to [columns] of a --map file; the file has"
                f" {', '.join(table.header)}",
            )
    return columns


def _check_single(
    columns: dict[str, str], given: ColumnMap, table: CsvTable, place: Place
) -> None:
    """Raises InputError for a second column of deviations that the map leaves open."""
    if any(name.startswith("deviation") for name in given.columns):
        return
    others = [h for h in table.header if h not in columns.values()]
    words, _ = WORDS["deviation"]
    second = [h for h in others if any(w in h.lower() for w in words)]
    if second:
        raise place.key("columns").error(
            f"two columns of deviations: {second[0]} as well",
            "write the runs below each other, with angles that fall on a clockwise run,"
            " or name one column: deviation_um",
        )


def _unit_in(header: str, quantity: str) -> str | None:
    """The unit that a header names, as in `Deviation (um)`."""
    text = header.replace("\u00b5", "u").replace("\u03bc", "u").replace("\u00b0", "deg")
    for word in "".join(c if c.isalnum() else " " for c in text).split()[1:]:
        if units.UNITS.get(word, ("", 0.0))[0] == QUANTITIES[quantity]:
            return word
    return None


def _traces(
    table: CsvTable, columns: dict[str, str], circle: CircleFacts
) -> list[BarTrace]:
    """The runs of a file, without feed-in and feed-out. Raises InputError."""
    values: dict[str, Array] = {}
    for name, source in columns.items():
        stem, _, unit = name.rpartition("_")
        values[stem] = units.to_si(table.numbers(source), unit)
    _check_size(values["deviation"], table, columns, circle)
    time = values.get("time", np.full(len(table), np.nan))
    angle = values.get("angle")
    angle = _angle_of_time(time, circle) if angle is None else np.unwrap(angle)
    runs = []
    for start, end in _runs(angle):
        part = BarTrace(
            angle[start:end], values["deviation"][start:end], time[start:end]
        )
        trace = _without_feeds(part, circle)
        if len(trace.angle) < FEWEST:
            name = next(iter(columns.values()))
            raise table.error(
                start,
                name,
                f"the run from here has {len(trace.angle)} points",
                f"give at least {FEWEST} between feed_in_deg and feed_out_deg",
            )
        runs.append(trace)
    return runs


def _check_size(
    deviation: Array, table: CsvTable, columns: dict[str, str], circle: CircleFacts
) -> None:
    """Raises InputError for the first deviation that cannot be one in its unit."""
    radius = float(units.to_si(circle.radius_mm, "mm"))
    large = np.flatnonzero(np.abs(deviation) > LARGEST * radius)
    if large.size:
        name = next(n for n in columns if n.startswith("deviation"))
        raise table.error(
            int(large[0]),
            columns[name],
            f"read as {name}, it is more than 5 % of the radius",
            "state the column's unit in [columns] of the map; give deviations, not"
            " lengths",
        )


def _angle_of_time(time: Array, circle: CircleFacts) -> Array:
    """Angle (n,), rad, of a trace over time at constant feed. Raises InputError."""
    if circle.feed_mm_min is None:
        raise (
            Place("--map")
            .key("circle")
            .key("feed_mm_min")
            .error(
                "missing", "a trace over time needs the feed, start_deg and direction"
            )
        )
    sense = 1.0 if circle.direction == "ccw" else -1.0
    rate = circle.feed_mm_min * units.MM_PER_MIN / (circle.radius_mm * units.MM)
    start = float(units.to_si(circle.start_deg, "deg"))
    return np.asarray(start + sense * rate * (time - time[0]))


def _runs(angle: Array) -> list[tuple[int, int]]:
    """First and last-but-one index of each stretch of angles that go one way."""
    jitter = float(units.to_si(JITTER, "deg"))
    bounds, start, turn, sense = [], 0, 0, 0
    for k in range(1, len(angle)):
        ahead = angle[k] - angle[turn]
        if sense == 0 and abs(ahead) > jitter:
            sense = 1 if ahead > 0.0 else -1
        if sense * ahead > 0.0:
            turn = k
        elif sense and -sense * ahead > jitter:
            bounds.append((start, turn + 1))
            start, turn, sense = turn + 1, k, -sense
    return [*bounds, (start, len(angle))]


def _without_feeds(trace: BarTrace, circle: CircleFacts) -> BarTrace:
    """The run without the arcs at its ends that are no readings."""
    travelled = np.abs(trace.angle - trace.angle[0])
    first = float(units.to_si(circle.feed_in_deg, "deg"))
    last = travelled[-1] - float(units.to_si(circle.feed_out_deg, "deg"))
    inside = (travelled >= first) & (travelled <= last)
    return BarTrace(*(values[inside] for values in trace))


# -- study and readings ----------------------------------------------------------------


def _study(
    request: ImportRequest,
    given: ColumnMap,
    circle: CircleFacts,
    model: Model,
    thinned: list[Thinned],
) -> str:
    cup = circle.cup_mm or circle.centre_mm
    setup: dict[str, object] = {"name": given.setup, "instrument": INSTRUMENT}
    setup["length_mm"] = circle.length_mm or circle.radius_mm
    setup |= {f"at_{axis}_mm": value for axis, value in zip("xyz", cup, strict=True)}
    if any(given.tool_mm):
        setup["tool_mm"] = list(given.tool_mm)
    sigma = math.sqrt(float(np.mean([t.sigma**2 for t in thinned])))
    noise = given.noise or {"length_um": float(f"{units.number(sigma, 'um'):.3g}")}
    title = f"Ball-bar circles of {model.machine.name}"
    return column_map.imported_study(request, model, title, setup, noise)


def _rows(
    traces: list[BarTrace],
    thinned: list[Thinned],
    given: ColumnMap,
    circle: CircleFacts,
    model: Model,
    place: Place,
) -> list[Row]:
    """One row a mean, commanded where the circle has its angle."""
    machine = model.machine
    known = {c.name: c.unit for c in machine.command}
    fixed = read_values(given.fixed, known, place.key("fixed"))
    tool = units.to_si(given.tool_mm, "mm")
    solver = ToolPoints(Kinematics(machine), tool.tolist())
    length = circle.length_mm or circle.radius_mm
    rows: list[Row] = []
    for k, (trace, mean) in enumerate(zip(traces, thinned, strict=True), start=1):
        sense = "ccw" if trace.direction > 0 else "cw"
        points = _points(mean.angle, circle)
        commands = solver.commands(points, fixed, place.key("circle"))
        for i, command in enumerate(commands):
            row = {
                "setup": given.setup,
                "run": f"circle {k} {sense}",
                "order": str(i + 1),
                "direction": str(trace.direction),
            }
            for c, value in zip(machine.command, command, strict=True):
                name = usual_column(c.name, c.unit)
                unit = name.rpartition("_")[2]
                row[name] = repr(units.number(float(value), unit))
            if np.isfinite(mean.time[i]):
                row["time_s"] = repr(float(mean.time[i]))
            if circle.feed_mm_min is not None:
                row["feed_mm_min"] = repr(circle.feed_mm_min)
            reading = length + units.number(float(mean.reading[i]), "mm")
            rows.append(row | {"length_mm": f"{reading:.9g}"})
    return rows


def _points(angle: Array, circle: CircleFacts) -> Array:
    """Points (n, 3), m, of the circle at angles (n,)."""
    first, second = PLANES[circle.plane]
    points = np.zeros((len(angle), 3))
    points[:, first], points[:, second] = np.cos(angle), np.sin(angle)
    centre = np.array(circle.centre_mm)
    return units.to_si(centre + circle.radius_mm * points, "mm")


def _statements(
    traces: list[BarTrace],
    thinned: list[Thinned],
    columns: dict[str, str],
    circle: CircleFacts,
) -> list[str]:
    taken = ", ".join(f"{source} as {name}" for name, source in columns.items())
    sentences = [f"Columns: {taken}."]
    for k, (trace, mean) in enumerate(zip(traces, thinned, strict=True), start=1):
        sense = "counter-clockwise" if trace.direction > 0 else "clockwise"
        ends = [f"{units.number(float(a), 'deg'):.4g}" for a in trace.angle[[0, -1]]]
        sentences.append(
            f"Run {k}: {len(trace.angle)} points, {sense} in {circle.plane} from"
            f" {ends[0]} to {ends[1]} deg; {len(mean.angle)} means of {mean.block}"
            f" points, sd {units.number(mean.sigma, 'um'):.3g} um, neighbours"
            f" correlated by {mean.lag_one:.2f}."
        )
    length = circle.length_mm or circle.radius_mm
    sentences.append(
        f"Lengths: deviation plus {length:g} mm; a longer bar is positive."
    )
    return sentences
