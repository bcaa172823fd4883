"""What the controller holds already: [machine] controller, from a result or a file."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oed import units
from oed.base import Array
from oed.compensate import InterpolationTable
from oed.mechanism import NO_TOOL, Controller, Kinematics
from oed.model import Machine
from oed.text import suggest
from pkm_studies import csv_table, files
from pkm_studies.base import InputError, Location
from pkm_studies.earlier_result import SAME, controller_values, named_result
from pkm_studies.quantities import column, display_unit
from pkm_studies.study import Study

#: rows of a table of parameters by name: value, unit, and nominal where it is there
Rows = Mapping[str, Mapping[str, Any]]
#: bytes of the largest file
LIMIT = 1 << 26
#: what counts as the same command, in the unit of its column: six decimals are written
SAME_COMMAND = 2e-6
REMEDY = (
    "name the folder of a result, or a file of `oed compensate DIR --to json` (or csv)"
)


def hold_parameters(study: Study, kinematics: Kinematics) -> Kinematics:
    """The kinematics under the controller that [machine] controller states.

    Raises InputError where there is no such file or folder, or it is of another machine.
    """
    name = study.machine.controller
    if name is None:
        return kinematics
    location = study.location.key("machine").key("controller")
    path, machine = study.folder / name, kinematics.machine
    if not path.is_file():
        if path.suffix in (".json", ".csv"):
            raise location.error(f"there is no file {path}", REMEDY, name)
        result, _ = named_result(study, name, location, machine)
        values, _ = controller_values(result, machine)
        return kinematics.with_controller(Controller(values))
    rows: Rows | None
    if path.suffix == ".json":
        rows = _json_rows(path, location, name, machine)
    elif path.suffix != ".csv":
        raise location.error("this is no table of parameters", REMEDY, name)
    else:
        with csv_table.named_errors(str(path)):
            rows = _csv_rows(path, location, name)
    if rows is None:
        return kinematics.with_controller(_tabled(kinematics, path, location))
    values = _parameters(rows, machine, location, name)
    return kinematics.with_controller(Controller(values))


# -- parameters ------------------------------------------------------------------------


def _json_rows(path: Path, location: Location, name: str, machine: Machine) -> Rows:
    """Rows {parameter: value, unit, nominal} of a compensation.json."""
    text = files.read_text(path, limit=LIMIT, what="parameter table")
    try:
        document = json.loads(text)
        rows: Rows = {str(n): dict(r) for n, r in document["parameters"].items()}
        other = str(document.get("machine", machine.name))
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise location.error("this is no table of parameters", REMEDY, name) from None
    if other != machine.name:
        raise _other_machine(location, name, f"{machine.name} for {other}")
    return rows


def _csv_rows(path: Path, location: Location, name: str) -> Rows | None:
    """The same of a table of parameters; None of a table of another kind."""
    text = files.read_text(path, limit=LIMIT, what="parameter table")
    reader = csv.DictReader(text.splitlines())
    if not {"name", "value", "unit"} <= set(reader.fieldnames or ()):
        return None
    rows: dict[str, Mapping[str, Any]] = {}
    for row in reader:
        parameter = str(row["name"])
        if parameter in rows:
            problem = f"{path.name} has several rows of {parameter}"
            raise location.error(problem, "leave one of them", name)
        rows[parameter] = row
    if not rows:
        raise location.error(f"{path.name} has no row", REMEDY, name)
    return rows


def _parameters(rows: Rows, machine: Machine, location: Location, name: str) -> Array:
    """Parameters (np,), SI; those without a row are nominal. Raises InputError."""
    values, names_of_machine = (
        machine.nominal.copy(),
        [p.name for p in machine.parameters],
    )
    for parameter, row in rows.items():
        if parameter not in names_of_machine:
            problem = f"{machine.name} has no parameter {parameter}"
            raise location.error(
                problem, suggest(parameter, names_of_machine, "parameters"), name
            )
        k = names_of_machine.index(parameter)
        si = machine.parameters[k].unit
        number, nominal = _number(row, "value"), _number(row, "nominal")
        unit = str(row.get("unit"))
        if unit not in units.UNITS or units.si_unit(unit) != si or number is None:
            problem = f"{parameter} has no number in a unit such as {display_unit(si)}"
            raise location.error(problem, REMEDY, name)
        values[k] = units.to_si(number, unit)
        drawn = units.number(machine.nominal[k], unit)
        if nominal is not None and not math.isclose(
            nominal, drawn, rel_tol=SAME, abs_tol=SAME
        ):
            phrase = f"{parameter} = {drawn:.9g} for {nominal:.9g} {unit}"
            raise _other_machine(location, name, phrase)
    return values


def _number(row: Mapping[str, Any], key: str) -> float | None:
    """A finite number of a row; None where there is none."""
    try:
        number = float(row[key])
    except (KeyError, TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _other_machine(location: Location, name: str, phrase: str) -> InputError:
    problem = f"it is the table of another machine: {phrase}"
    return location.error(problem, "name a table of this machine", name)


# -- joint corrections -----------------------------------------------------------------


def _tabled(kinematics: Kinematics, path: Path, location: Location) -> Controller:
    """A controller with nominal parameters that adds the corrections of a table."""
    machine = kinematics.machine
    joints = [(f"correction_{j.name}", j.unit) for j in machine.joints]
    rows = csv_table.read(path)
    absent = [c for c in (column(*joint) for joint in joints) if c not in rows.header]
    if absent:
        problem = f"{path} has neither parameters nor a column {absent[0]}"
        raise location.error(problem, REMEDY, path.name)
    knots, turns = _knots(machine, path.with_name(f"{path.stem}_grid.csv"))
    values = np.column_stack([_column(rows, *joint) for joint in joints])
    commands = np.column_stack([_column(rows, c.name, c.unit) for c in machine.command])
    shape = tuple(len(places) for places in knots)
    nodes = np.stack(np.meshgrid(*knots, indexing="ij"), -1).reshape(-1, len(knots))
    factors = [units.factor(display_unit(c.unit)) for c in machine.command]
    slack = SAME_COMMAND * np.array(factors)
    if nodes.shape != commands.shape or (np.abs(nodes - commands) > slack).any():
        problem = f"the rows of {path} are not those of its grid"
        raise location.error(problem, "take both files as they were written", path.name)
    names = tuple(c.name for c in machine.command)
    table = InterpolationTable(names, knots, values.reshape(*shape, -1), turns)

    def corrections(command: Array, pose: Array) -> Array:
        """The table is over commands of the reference tool."""
        return table.at(kinematics.command_of_pose(pose, command, NO_TOOL))

    return Controller(machine.nominal, corrections)


def _knots(machine: Machine, path: Path) -> tuple[tuple[Array, ...], tuple[bool, ...]]:
    """Places along the axes of a table, SI, and which axes are a full turn."""
    if not path.is_file():
        raise InputError(
            "the axes of the table are missing",
            "keep the files of `oed compensate --to csv` together",
            file=str(path),
        )
    rows = csv_table.read(path)
    ends = zip(rows.numbers("first"), rows.numbers("last"), strict=True)
    counts, turns = rows.numbers("count"), rows.cells("repeats")
    names = rows.cells("coordinate")
    wanted = [column(c.name, c.unit) for c in machine.command]
    if names != wanted or (counts < 1).any():
        raise InputError(
            f"its axes are {', '.join(names)}, those of the machine {', '.join(wanted)}",
            "name a table of this machine",
            file=str(path),
        )
    factors = [units.factor(display_unit(c.unit)) for c in machine.command]
    knots = tuple(
        np.linspace(first, last, int(count)) * factor
        for (first, last), count, factor in zip(ends, counts, factors, strict=True)
    )
    return knots, tuple(word == "yes" for word in turns)


def _column(rows: csv_table.CsvTable, name: str, si: str) -> Array:
    """A column of the table, SI."""
    return units.to_si(rows.numbers(column(name, si)), display_unit(si))
