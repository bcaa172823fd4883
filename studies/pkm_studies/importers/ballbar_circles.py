"""Circles of a ball-bar import: which runs of which files belong to which circle."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

from pkm_studies.base import Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers.ballbar_traces import BarTrace, run_numbers, traces
from pkm_studies.importers.map_tables import CircleFacts, CircleOfFiles, ColumnMap


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
    """The circles of [circle], which has all runs, or of [[circles]].

    Raises InputError where a run belongs to no circle, or to two.
    """
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
            field, remedy = location.key("files").item(i), ", ".join(by_name)
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
        numbers = run_numbers(table, columns, facts)
        for number in sorted(set(numbers) - taken[table.file]):
            raise location.error(
                f"run {number} of {name} belongs to no circle",
                "add it to runs of a circle, or cut it from the file",
            )


# -- set-ups ---------------------------------------------------------------------------


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
                location.item(k)
                .key("setup")
                .error(
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
    number, name = len(mounted) + 1, stem
    while name in mounted:
        name = f"{stem.rstrip('0123456789')}{number}"
        number += 1
    return name
