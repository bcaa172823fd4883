"""Ball-bar traces: deviation of the bar's length against angle, or against time.

One file has one run or several. Deviations are added to the bar's length. The map's table
[circle] says where the circle was, its tables [[circles]] where each of several was.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies.base import Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import column_map
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row
from pkm_studies.importers.column_map import Model
from pkm_studies.importers.line_times import read_tables
from pkm_studies.importers.map_tables import CircleFacts, CircleOfFiles, ColumnMap
from pkm_studies.quantities import column as usual_column
from pkm_studies.quantities import read_values
from pkm_studies.resolve import ToolPoints
from pkm_studies.tables import CIRCLE_PLANES

# Columns and runs of ball-bar traces: deviation against angle, or against time.
#
# A run ends where the angle turns back, which is how a forward and a backward circle
# follow each other in one file.

#: columns of a trace, with their SI units
QUANTITIES = {"angle": "rad", "time": "s", "deviation": "m"}
#: words by which a column without a map is recognised, and its unit where none is named
WORDS = {
    "angle": (("angle", "winkel", "theta"), "deg"),
    "time": (("time", "zeit"), "s"),
    "deviation": (("deviation", "error", "abweichung"), "um"),
}
ANGLE_JITTER_DEG = 1.0  #: an angle that goes back by less is jitter, deg
#: largest deviation that is no mistake in the unit, over the radius
MAX_DEVIATION_SHARE = 0.05
MIN_CIRCLE_READINGS = 8


class BarTrace(NamedTuple):
    """A run: angle (n,) rad, deviation (n,) m, time (n,) s or NaN."""

    angle: Array
    deviation: Array
    time: Array

    @property
    def direction(self) -> int:
        """+1 counter-clockwise, -1 clockwise."""
        return 1 if self.angle[-1] > self.angle[0] else -1


def trace_columns(
    mapping: ColumnMap, table: CsvTable, location: Location
) -> dict[str, str]:
    """Column of the CSV by quantity with unit. Raises InputError."""
    columns = {}
    for name, source in mapping.columns.items():
        if not isinstance(source, str):
            field = location.path("columns", name)
            problem = "a column of a ball bar takes no factor or offset"
            raise field.error(problem, "state its unit in the name, as in deviation_um")
        columns[name] = source
        read_values({name: 0.0}, QUANTITIES, location.key("columns"))
        if source not in table.header:
            field, remedy = location.path("columns", name), ", ".join(table.header)
            problem = "the file has no such column"
            raise field.error(problem, f"the file has {remedy}", source)
    stems = {name.rpartition("_")[0] for name in columns}
    for quantity, (labels, unit) in WORDS.items():
        for header in table.header:
            if quantity not in stems and any(w in header.lower() for w in labels):
                columns[f"{quantity}_{_unit_in(header, quantity) or unit}"] = header
                stems.add(quantity)
    _check_single(columns, mapping, table, location)
    for wanted in (("deviation",), ("angle", "time")):
        if not stems & set(wanted):
            name = usual_column(wanted[0], QUANTITIES[wanted[0]])
            raise location.key("columns").error(
                f"no column for {' or '.join(wanted)}",
                f"add {name} to [columns] of a --map file; the file has"
                f" {', '.join(table.header)}",
            )
    return columns


def _check_single(
    columns: dict[str, str], mapping: ColumnMap, table: CsvTable, location: Location
) -> None:
    """Raises InputError for a second column of deviations that the map leaves open."""
    if any(name.startswith("deviation") for name in mapping.columns):
        return
    others = [h for h in table.header if h not in columns.values()]
    labels, _ = WORDS["deviation"]
    second = [h for h in others if any(w in h.lower() for w in labels)]
    if second:
        raise location.key("columns").error(
            f"two columns of deviations: {second[0]} as well",
            "write the runs below each other, with angles that fall on a clockwise run,"
            " or name one column: deviation_um",
        )


def _unit_in(header: str, quantity: str) -> str | None:
    """The unit that a header names, as in `Deviation (um)`."""
    text = header.replace("\u00b5", "u").replace("\u03bc", "u").replace("\u00b0", "deg")
    tokens = "".join(c if c.isalnum() else " " for c in text).split()[1:]
    wanted = QUANTITIES[quantity]
    candidates = [w for w in tokens if units.UNITS.get(w, ("", 0.0))[0] == wanted]
    # "in" is a word as well: another unit goes before it
    candidates.sort(key=lambda word: word == "in")
    return candidates[0] if candidates else None


def traces(
    table: CsvTable,
    columns: dict[str, str],
    circle: CircleFacts,
    numbers: Sequence[int] | None = None,
) -> dict[int, BarTrace]:
    """The runs of a file by number, from 1, without feed-in and feed-out.

    numbers  runs of this circle; all by default. Those that the file does not have are
             left out

    Raises InputError.
    """
    whole = _whole(table, columns, circle)
    _check_size(whole.deviation, table, columns, circle)
    runs = {}
    for number, (start, end) in enumerate(_runs(whole.angle), start=1):
        if numbers is not None and number not in numbers:
            continue
        part = BarTrace(*(values[start:end] for values in whole))
        trace = _drop_feeds(part, circle)
        if len(trace.angle) < MIN_CIRCLE_READINGS:
            name = next(iter(columns.values()))
            raise table.error(
                start,
                name,
                f"the run from here has {len(trace.angle)} points",
                f"give at least {MIN_CIRCLE_READINGS} between feed_in_deg and feed_out_deg",
            )
        runs[number] = trace
    return runs


def _whole(table: CsvTable, columns: dict[str, str], circle: CircleFacts) -> BarTrace:
    """All points of a file, run after run. Raises InputError."""
    values: dict[str, Array] = {}
    for name, source in columns.items():
        stem, _, unit = name.rpartition("_")
        values[stem] = units.to_si(table.numbers(source), unit)
    time = values.get("time", np.full(len(table), np.nan))
    angle = values.get("angle")
    angle = _angle_of_time(time, circle) if angle is None else np.unwrap(angle)
    return BarTrace(angle, values["deviation"], time)


def _check_size(
    deviation: Array, table: CsvTable, columns: dict[str, str], circle: CircleFacts
) -> None:
    """Raises InputError for the first deviation that cannot be one in its unit."""
    radius = float(units.to_si(circle.radius_mm, "mm"))
    large = np.flatnonzero(np.abs(deviation) > MAX_DEVIATION_SHARE * radius)
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
            Location("--map")
            .path("circle", "feed_mm_min")
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
    jitter = float(units.to_si(ANGLE_JITTER_DEG, "deg"))
    bounds = []
    start = 0
    turn = 0
    sense = 0
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


def _drop_feeds(trace: BarTrace, circle: CircleFacts) -> BarTrace:
    """The run without the arcs at its ends that are no readings."""
    travelled = np.abs(trace.angle - trace.angle[0])
    first = float(units.to_si(circle.feed_in_deg, "deg"))
    last = travelled[-1] - float(units.to_si(circle.feed_out_deg, "deg"))
    inside = (travelled >= first) & (travelled <= last)
    return BarTrace(*(values[inside] for values in trace))


# Ball-bar traces: deviation of the bar's length against angle, or against time.

MAX_HARMONIC = 15  #: harmonics of a turn that are not noise, at most
INSTRUMENT = "ball_bar_free_cup"


class _CircleRun(NamedTuple):
    """A run with its number in the import, as read and thinned."""

    number: int
    circle: MeasuredCircle
    trace: BarTrace
    mean: Thinned


def _pairs(
    circles: Sequence[MeasuredCircle],
) -> Iterator[tuple[MeasuredCircle, BarTrace]]:
    for circle in circles:
        for trace in circle.runs:
            yield circle, trace


class BallbarImporter:
    """Takes traces, thins them, and puts their points on the machine's circle."""

    name = "ballbar"
    about = "ball-bar traces (CSV): angle or time against deviation, both directions"
    unused = ("--mesh",)

    def read(self, request: ImportRequest) -> ImportedSession:
        """All runs of all files. Raises InputError."""
        mapping, location = column_map.load(request)
        model = column_map.model(request, mapping, location)
        tables = read_tables(request.files)
        columns = trace_columns(mapping, tables[0], location)
        circles = measured_circles(mapping, tables, columns, location)
        runs = [
            _CircleRun(number, circle, trace, thin(*trace, circle.facts.readings))
            for number, (circle, trace) in enumerate(_pairs(circles), start=1)
        ]
        complete = msgspec.structs.replace(
            mapping,
            machine=model.described,
            instrument=INSTRUMENT,
            columns=dict(columns),
        )
        return ImportedSession(
            study=_study(request, complete, circles, model, runs),
            rows=_rows(runs, complete, model, location),
            statements=_statements(runs, columns, tables),
            column_map=column_map.text(complete),
        )


importer = BallbarImporter()


# -- study and readings ----------------------------------------------------------------
def _study(
    request: ImportRequest,
    mapping: ColumnMap,
    circles: Sequence[MeasuredCircle],
    model: Model,
    runs: Sequence[_CircleRun],
) -> str:
    setups: dict[str, dict[str, object]] = {}
    for circle in circles:
        setup: dict[str, object] = {"name": circle.setup, "instrument": INSTRUMENT}
        setup["length_mm"] = circle.length
        cup = zip("xyz", circle.cup, strict=True)
        setup |= {f"at_{axis}_mm": value for axis, value in cup}
        if any(mapping.tool_mm):
            setup["tool_mm"] = list(mapping.tool_mm)
        setups[circle.setup] = setup
    sigma = math.sqrt(float(np.mean([run.mean.sigma**2 for run in runs])))
    noise = mapping.noise or {"length_um": float(f"{units.number(sigma, 'um'):.3g}")}
    title = f"Ball-bar circles of {model.machine.name}"
    return column_map.imported_study(
        request, model, title, list(setups.values()), noise
    )


def _rows(
    runs: Sequence[_CircleRun], mapping: ColumnMap, model: Model, location: Location
) -> list[Row]:
    """One row a mean, commanded where the circle has its angle."""
    machine = model.machine
    unit_of = {c.name: c.unit for c in machine.command}
    fixed = read_values(mapping.fixed, unit_of, location.key("fixed"))
    tool = units.to_si(mapping.tool_mm, "mm")
    solver = ToolPoints(Kinematics(machine), tool.tolist())
    rows: list[Row] = []
    for run in runs:
        points = _points(run.mean.angle, run.circle.facts)
        commands = solver.commands(points, fixed, location.key("circle"))
        rows += [_row(run, i, command, machine) for i, command in enumerate(commands)]
    return rows


def _row(run: _CircleRun, i: int, command: Array, machine: Machine) -> Row:
    facts, mean = run.circle.facts, run.mean
    row = {
        "setup": run.circle.setup,
        "run": f"circle {run.number} {'ccw' if run.trace.direction > 0 else 'cw'}",
        "order": str(i + 1),
        "direction": str(run.trace.direction),
    }
    for c, value in zip(machine.command, command, strict=True):
        name = usual_column(c.name, c.unit)
        unit = name.rpartition("_")[2]
        row[name] = repr(units.number(float(value), unit))
    if np.isfinite(mean.time[i]):
        row["time_s"] = repr(float(mean.time[i]))
    if facts.feed_mm_min is not None:
        row["feed_mm_min"] = repr(facts.feed_mm_min)
    reading = run.circle.length + units.number(float(mean.reading[i]), "mm")
    return row | {"length_mm": f"{reading:.9g}"}


def _points(angle: Array, circle: CircleFacts) -> Array:
    """Points (n, 3), m, of the circle at angles (n,)."""
    first, second = CIRCLE_PLANES[circle.plane]
    points = np.zeros((len(angle), 3))
    points[:, first], points[:, second] = np.cos(angle), np.sin(angle)
    centre = np.array(circle.centre_mm)
    return units.to_si(centre + circle.radius_mm * points, "mm")


def _statements(
    runs: Sequence[_CircleRun], columns: dict[str, str], tables: Sequence[CsvTable]
) -> list[str]:
    taken = ", ".join(f"{source} as {name}" for name, source in columns.items())
    sentences = [f"Columns: {taken}."]
    headers = dict.fromkeys(name for table in tables for name in table.header)
    unused = [name for name in headers if name not in columns.values()]
    if unused:
        sentences.append(f"Not used: {', '.join(unused)}.")
    for run in runs:
        trace, mean, facts = run.trace, run.mean, run.circle.facts
        sense = "counter-clockwise" if trace.direction > 0 else "clockwise"
        ends = [f"{units.number(float(a), 'deg'):.4g}" for a in trace.angle[[0, -1]]]
        centre = ", ".join(f"{v:g}" for v in facts.centre_mm)
        sentences.append(
            f"Run {run.number} ({run.circle.setup}): {len(trace.angle)} points,"
            f" {sense} in {facts.plane} about ({centre}) mm from"
            f" {ends[0]} to {ends[1]} deg; {len(mean.angle)} means of {mean.block}"
            f" points, sd {units.number(mean.sigma, 'um'):.3g} um, neighbours"
            f" correlated by {mean.lag_one:.2f}."
        )
    for name, length in {run.circle.setup: run.circle.length for run in runs}.items():
        sentences.append(
            f"Lengths of {name}: deviation plus {length:g} mm; a longer bar is positive."
        )
    return sentences


# -- thinning of dense traces ----------------------------------------------------------
#
# Neighbouring points of a trace share noise, so that a mean of m points has a variance of
# sigma^2 / m (1 + 2 sum_j (1 - j/m) rho_j), not sigma^2 / m. It is estimated from the
# means themselves: what a Fourier series over the angle leaves of them.
@dataclasses.dataclass(frozen=True)
class Thinned:
    """A trace of block means."""

    angle: Array  #: (n,) rad
    reading: Array  #: (n,) m
    time: Array  #: (n,) s, NaN where unknown
    block: int  #: points a mean
    sigma: float  #: standard deviation of a mean, m
    lag_one: float  #: correlation of neighbouring means


def thin(angle: Array, reading: Array, time: Array, most: int) -> Thinned:
    """A trace (n,) as at most `most` means of whole blocks of equal length."""
    block = max(1, -(-len(angle) // most))
    count = len(angle) // block

    def means(values: Array) -> Array:
        return np.asarray(values[: count * block].reshape(count, block).mean(axis=1))

    around, level = means(angle), means(reading)
    residual, free = _residual(around, level)
    sigma = float(np.sqrt(np.sum(residual**2) / max(free, 1)))
    lag_one = 0.0
    if free > 1 and sigma > 0.0:
        lag_one = float(residual[1:] @ residual[:-1] / np.sum(residual**2))
    return Thinned(around, level, means(time), block, sigma, lag_one)


def _residual(angle: Array, reading: Array) -> tuple[Array, int]:
    """What a Fourier series over the angle leaves, and its degrees of freedom."""
    turns = abs(angle[-1] - angle[0]) / (360.0 * units.DEG)
    harmonics = min(MAX_HARMONIC, int(len(angle) * min(turns, 1.0)) // 6)
    columns = [np.ones_like(angle)]
    for k in range(1, harmonics + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    basis = np.column_stack(columns)
    fitted, _, rank, _ = np.linalg.lstsq(basis, reading)
    return reading - basis @ fitted, len(angle) - int(rank)


# Circles of a ball-bar import: which runs of which files belong to which circle.
@dataclasses.dataclass(frozen=True)
class MeasuredCircle:
    """A circle of the map with its runs, in a set-up."""

    facts: CircleFacts
    setup: str
    runs: list[BarTrace]

    @property
    def cup(self) -> tuple[float, float, float]:
        """Place of the table's cup, mm."""
        return self.facts.cup_mm or self.facts.centre_mm

    @property
    def length(self) -> float:
        """Length of the bar to which deviations are added, mm."""
        return self.facts.length_mm or self.facts.radius_mm


def measured_circles(
    mapping: ColumnMap,
    tables: Sequence[CsvTable],
    columns: dict[str, str],
    location: Location,
) -> list[MeasuredCircle]:
    """The circles of [circle] or [[circles]]. Raises InputError unless each run has one."""
    if mapping.circle is not None and mapping.circles:
        raise location.key("circles").error(
            "[circle] is given as well", "move it into a table [[circles]] of its own"
        )
    if mapping.circle is not None:
        facts = mapping.circle
        runs = [run for t in tables for run in traces(t, columns, facts).values()]
        return [MeasuredCircle(facts, mapping.setup, runs)]
    if not mapping.circles:
        raise location.key("circle").error(
            "missing",
            "give a --map file with [circle] centre_mm = [x, y, z] and radius_mm, or"
            " [[circles]] of several",
        )
    return _several(mapping, tables, columns, location.key("circles"))


def _several(
    mapping: ColumnMap,
    tables: Sequence[CsvTable],
    columns: dict[str, str],
    location: Location,
) -> list[MeasuredCircle]:
    names = _setups(mapping, location)
    taken: dict[str, set[int]] = {table.file: set() for table in tables}
    circles = []
    for k, facts in enumerate(mapping.circles):
        runs: list[BarTrace] = []
        for table in _tables_of(k, mapping.circles, tables, location.item(k)):
            measured = traces(table, columns, facts, facts.runs or None)
            _check_runs(facts, measured, taken[table.file], table, location.item(k))
            taken[table.file] |= set(measured)
            runs += measured.values()
        circles.append(MeasuredCircle(facts, names[k], runs))
    _check_all_taken(mapping.circles[-1], tables, columns, taken, location)
    return circles


def _tables_of(
    k: int,
    circles: Sequence[CircleOfFiles],
    tables: Sequence[CsvTable],
    location: Location,
) -> Iterator[CsvTable]:
    """The files of circle k: those that it names, else the k-th. Raises InputError."""
    by_name = {Path(table.file).name: table for table in tables}
    if not circles[k].files:
        if len(circles) != len(tables) or any(c.files for c in circles):
            raise location.key("files").error(
                f"{len(circles)} circles are in {len(tables)} files",
                f"name the files of each circle: {', '.join(by_name)}",
            )
        yield tables[k]
    for i, name in enumerate(circles[k].files):
        if name not in by_name:
            field, remedy = location.path("files", i), ", ".join(by_name)
            raise field.error("this file is not imported", f"there are {remedy}", name)
        yield by_name[name]


def _check_runs(
    facts: CircleOfFiles,
    measured: dict[int, BarTrace],
    taken: set[int],
    table: CsvTable,
    location: Location,
) -> None:
    """Raises InputError for runs that the file lacks, or another circle has."""
    name = Path(table.file).name
    for number in facts.runs:
        if number not in measured:
            raise location.key("runs").error(
                f"{name} has no such run", "a run ends where the angle turns", number
            )
    for number in sorted(taken & set(measured)):
        raise location.key("runs").error(
            f"run {number} of {name} belongs to another circle as well",
            "name the runs of each circle: runs = [1, 2]",
        )


def _check_all_taken(
    facts: CircleFacts,
    tables: Sequence[CsvTable],
    columns: dict[str, str],
    taken: dict[str, set[int]],
    location: Location,
) -> None:
    """Raises InputError for a file or run that belongs to no circle."""
    for table in tables:
        name = Path(table.file).name
        if not taken[table.file]:
            remedy = "name it in files of a circle, or leave the file out"
            raise location.error(f"{name} belongs to no circle", remedy)
        numbers = range(1, 1 + len(_runs(_whole(table, columns, facts).angle)))
        for number in sorted(set(numbers) - taken[table.file]):
            raise location.error(
                f"run {number} of {name} belongs to no circle",
                "add it to runs of a circle, or cut it from the file",
            )


def _setups(mapping: ColumnMap, location: Location) -> list[str]:
    """The set-up of each circle: one for each place of the cup and bar."""
    mounted: dict[str, object] = {}
    names = []
    for k, circle in enumerate(mapping.circles):
        mounting = (
            circle.cup_mm or circle.centre_mm,
            circle.length_mm or circle.radius_mm,
        )
        name = circle.setup or _name(mapping.setup, mounting, mounted)
        if mounted.setdefault(name, mounting) != mounting:
            raise (
                location.path(k, "setup").error(
                    "another circle of this set-up has its cup or bar elsewhere",
                    "give the same cup_mm and length_mm, or another set-up",
                    name,
                )
            )
        names.append(name)
    return names


def _name(stem: str, mounting: object, mounted: dict[str, object]) -> str:
    """The set-up that has this mounting, else a new one: setup1, setup2, ..."""
    for name, other in mounted.items():
        if other == mounting:
            return name
    number = len(mounted) + 1
    name = stem
    while name in mounted:
        name = f"{stem.rstrip('0123456789')}{number}"
        number += 1
    return name
