"""Columns and runs of ball-bar traces: deviation against angle, or against time.

A run ends where the angle turns back, which is how a forward and a backward circle
follow each other in one file.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oed import units
from oed.base import Array
from pkm_studies.base import Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers.map_tables import CircleFacts, ColumnMap
from pkm_studies.quantities import column as usual_column
from pkm_studies.quantities import read_values

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


def trace_columns(
    mapping: ColumnMap, table: CsvTable, location: Location
) -> dict[str, str]:
    """Column of the CSV by quantity with unit. Raises InputError."""
    columns = {}
    for name, source in mapping.columns.items():
        if not isinstance(source, str):
            field = location.key("columns").key(name)
            problem = "a column of a ball bar takes no factor or offset"
            raise field.error(problem, "state its unit in the name, as in deviation_um")
        columns[name] = source
        read_values({name: 0.0}, QUANTITIES, location.key("columns"))
        if source not in table.header:
            field, remedy = location.key("columns").key(name), ", ".join(table.header)
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
        if len(trace.angle) < FEWEST:
            name = next(iter(columns.values()))
            raise table.error(
                start,
                name,
                f"the run from here has {len(trace.angle)} points",
                f"give at least {FEWEST} between feed_in_deg and feed_out_deg",
            )
        runs[number] = trace
    return runs


def run_numbers(table: CsvTable, columns: dict[str, str], circle: CircleFacts) -> range:
    """Numbers of all runs of a file, from 1."""
    return range(1, 1 + len(_runs(_whole(table, columns, circle).angle)))


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
            Location("--map")
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


def _drop_feeds(trace: BarTrace, circle: CircleFacts) -> BarTrace:
    """The run without the arcs at its ends that are no readings."""
    travelled = np.abs(trace.angle - trace.angle[0])
    first = float(units.to_si(circle.feed_in_deg, "deg"))
    last = travelled[-1] - float(units.to_si(circle.feed_out_deg, "deg"))
    inside = (travelled >= first) & (travelled <= last)
    return BarTrace(*(values[inside] for values in trace))
