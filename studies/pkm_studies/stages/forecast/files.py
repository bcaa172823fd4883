"""Files of a forecast: nodes to fill in, nodes as measured, and the controller's table."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from oed import csv_text, units
from oed.base import Array
from oed.compensate import commands_of_added
from oed.dataset import commented
from oed.forecast import Forecast
from oed.mechanism import Kinematics
from oed.model import Component
from pkm_studies import csv_table, describe
from pkm_studies.base import InputError
from pkm_studies.csv_table import CsvTable
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import readings_comments
from pkm_studies.stages.forecast.task import ForecastTask

NODES, TABLE = "forecast_nodes.csv", "forecast_table.csv"
#: columns of a component's measured error, and of its standard deviation
ERROR, SIGMA = "error_{}_{}", "sigma_{}_{}"
#: decimals of the table, in mm and degrees
DECIMALS = 6


def error_columns(components: tuple[Component, ...], pattern: str) -> list[str]:
    """Column of each component."""
    return [pattern.format(c.name, units.FINE[c.unit]) for c in components]


def nodes_csv(task: ForecastTask, nodes: Array) -> str:
    """Nodes (n, n_dof), SI, with empty columns for the measured errors."""
    machine, driven = task.kinematics.machine, task.model.driven
    names = error_columns(driven, ERROR)
    commands = [describe.displayed_command(machine, node) for node in nodes]
    lines = readings_comments(machine, {}, list(commands[0]))
    reference = f"reference: {task.model.reference}"
    about = [
        f"{name}: {component.about or component.name}; {reference}"
        for name, component in zip(names, driven, strict=True)
    ]
    rows = [
        [*(f"{value:.10g}" for value in command.values()), *[""] * len(names)]
        for command in commands
    ]
    header = [*commands[0], *names]
    return commented([*lines, *about]) + csv_text.of_rows([header, *rows])


def read_nodes(task: ForecastTask, path: Path) -> tuple[Array, Array, Array]:
    """Commands (n, n_dof), errors (n, k), NaN where none, and their noise (n, k), SI.

    Raises InputError for a command out of range, a noise that is not positive, and where
    no error was measured.
    """
    machine, driven = task.kinematics.machine, task.model.driven
    table = csv_table.read(path)
    names = list(describe.displayed_command(machine, machine.home_command))
    command = np.column_stack(
        [
            units.to_si(table.numbers(name), display_unit(c.unit))
            for name, c in zip(names, machine.command, strict=True)
        ]
    )
    _check_range(task, table, names, command)
    errors, sigma = [], []
    pairs = zip(error_columns(driven, ERROR), error_columns(driven, SIGMA), strict=True)
    for k, (error, noise) in enumerate(pairs):
        unit = units.FINE[driven[k].unit]
        errors.append(units.to_si(table.numbers(error, gaps=True), unit))
        sigma.append(_noise(table, noise, unit, float(task.sigma[k])))
    read = np.column_stack(errors)
    if np.isnan(read).all():
        raise InputError(
            "no error was measured", "fill in the columns error_...", file=table.file
        )
    measured = ~np.isnan(read).all(axis=1)
    return command[measured], read[measured], np.column_stack(sigma)[measured]


def _noise(table: CsvTable, name: str, unit: str, usual: float) -> Array:
    """Standard deviation (n,) of each row, SI."""
    if name not in table.header:
        return np.full(len(table), usual)
    values = table.numbers(name, gaps=True)
    for k in np.flatnonzero(values <= 0.0):
        remedy = "give a standard deviation > 0, or leave the cell empty"
        raise table.error(int(k), name, "not positive", remedy)
    return np.asarray(np.where(np.isnan(values), usual, units.to_si(values, unit)))


def _check_range(
    task: ForecastTask, table: CsvTable, names: list[str], command: Array
) -> None:
    """Raises InputError for the first command out of the machine's range."""
    for j, coordinate in enumerate(task.kinematics.machine.command):
        slack = 1e-6 * (coordinate.upper - coordinate.lower)
        low, high = coordinate.lower - slack, coordinate.upper + slack
        for k in np.flatnonzero((command[:, j] < low) | (command[:, j] > high)):
            remedy = "measure within the machine's range"
            raise table.error(int(k), names[j], "out of the machine's range", remedy)


def table_csv(kinematics: Kinematics, forecast: Forecast) -> str:
    """Corrections of the joints and corrected commands over the grid of commands."""
    machine, command = kinematics.machine, forecast.grid.commands
    corrected = commands_of_added(kinematics, command, forecast.joints)
    columns: dict[str, Array] = {}
    for k, c in enumerate(machine.command):
        columns[column(c.name, c.unit)] = _shown(command[:, k], c.unit)
    for name, values in table_corrections(kinematics, forecast).items():
        columns[name] = np.array(values)
    for k, c in enumerate(machine.command):
        columns[column(f"corrected_{c.name}", c.unit)] = _shown(corrected[:, k], c.unit)
    rows = (
        [f"{value:.{DECIMALS}f}" for value in row]
        for row in zip(*columns.values(), strict=True)
    )
    return commented(_table_comments(kinematics)) + csv_text.of_rows(
        [[*columns], *rows]
    )


def table_places(kinematics: Kinematics, forecast: Forecast) -> dict[str, list[float]]:
    """Places of the table's nodes by column of the command."""
    pairs = zip(kinematics.machine.command, forecast.grid.knots, strict=True)
    return {column(c.name, c.unit): _shown(k, c.unit).tolist() for c, k in pairs}


def table_corrections(
    kinematics: Kinematics, forecast: Forecast
) -> dict[str, list[float]]:
    """What the table adds to the joints at its nodes, by column."""
    return {
        column(f"correction_{j.name}", j.unit): _shown(values, j.unit).tolist()
        for j, values in zip(kinematics.machine.joints, forecast.joints.T, strict=True)
    }


def _table_comments(kinematics: Kinematics) -> Iterator[str]:
    machine = kinematics.machine
    names = list(describe.displayed_command(machine, machine.home_command))
    yield from readings_comments(machine, {}, names)
    yield (
        "correction_...: to add to the joints that the controller has for the command;"
        " interpolate linearly, beyond the grid its border holds"
    )
    yield "corrected_...: the command to send instead, where the joints are out of reach"


def _shown(values: Array, unit: str) -> Array:
    return np.asarray(units.from_si(values, display_unit(unit)))
