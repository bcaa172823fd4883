"""Ball-bar traces: deviation of the bar's length against angle, or against time.

One file has one run or several. Deviations are added to the bar's length. The map's table
[circle] says where the circle was, its tables [[circles]] where each of several was.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
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
from pkm_studies.importers.ballbar_circles import MeasuredCircle, measured_circles
from pkm_studies.importers.ballbar_traces import BarTrace, trace_columns
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row
from pkm_studies.importers.column_map import Model
from pkm_studies.importers.line_times import read_tables
from pkm_studies.importers.map_tables import CircleFacts, ColumnMap
from pkm_studies.quantities import column as usual_column
from pkm_studies.quantities import read_values
from pkm_studies.resolve import ToolPoints
from pkm_studies.tables import CIRCLE_PLANES

#: harmonics of a turn that are not noise, at most
HARMONICS = 15
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
    """Mean i of a run."""
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
    """A trace of block means.

    angle    (n,) rad
    reading  (n,) m
    time     (n,) s, NaN where unknown
    block    points a mean
    sigma    standard deviation of a mean, m
    lag_one  correlation of neighbouring means
    """

    angle: Array
    reading: Array
    time: Array
    block: int
    sigma: float
    lag_one: float


def thin(angle: Array, reading: Array, time: Array, most: int) -> Thinned:
    """A trace (n,) as at most `most` means of blocks of equal length.

    Points beyond the last whole block, fewer than a block, are left out.
    """
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
    harmonics = min(HARMONICS, int(len(angle) * min(turns, 1.0)) // 6)
    columns = [np.ones_like(angle)]
    for k in range(1, harmonics + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    basis = np.column_stack(columns)
    fitted, _, rank, _ = np.linalg.lstsq(basis, reading)
    return reading - basis @ fitted, len(angle) - int(rank)
