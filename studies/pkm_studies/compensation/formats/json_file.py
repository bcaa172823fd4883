"""JSON: everything, at full precision."""

import json
from typing import Any

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.compensate import commands_of_added, compensated_joints, joint_corrections
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.quantities import column, display_unit


def write(compensation: Compensation) -> Texts:
    """Parameters with sd, and a table of corrections over the workspace."""
    document = {
        "schema": 1,
        "program": f"pkm-oed {compensation.version}",
        "study": compensation.study,
        "machine": compensation.machine.name,
        "notes": list(compensation.notes),
        "parameters": _parameters(compensation),
        "columns": columns_about(compensation),
        "grid": grid_rows(compensation),
        "table": table(compensation),
    }
    if compensation.tables:
        document["effects"] = msgspec.to_builtins(compensation.tables)
    return {".json": json.dumps(document, indent=1) + "\n"}


def _parameters(compensation: Compensation) -> dict[str, Any]:
    parameters = {}
    identified = compensation.identified
    for k, p in enumerate(compensation.machine.parameters):
        unit = units.display(p.unit)
        parameters[p.name] = {
            "value": units.number(identified.values[k], unit),
            "sd": units.number(identified.sd[k], unit),
            "nominal": units.number(p.nominal, unit),
            "unit": unit,
        }
    return parameters


def table(compensation: Compensation) -> dict[str, list[float]]:
    """Columns of the workspace: commands, corrected commands, joints, joint corrections.

    Corrected commands and joint corrections are for a controller that keeps the nominal
    model; the corrections are to be interpolated. Where the machine has no drive for a
    motion, its offsets for additional axes follow.
    """
    kinematics, machine = compensation.kinematics, compensation.machine
    values = compensation.identified.values
    command = compensation.tabled
    corrected = kinematics.corrected_commands(command, values)
    joints = compensated_joints(kinematics, command, values)
    added = joint_corrections(kinematics, command, values)
    if compensation.forecast is not None:
        forecast = compensation.forecast(command)
        joints, added = joints + forecast, added + forecast
        corrected = commands_of_added(kinematics, command, added)
    columns = {}
    for prefix, block in (("", command), ("corrected_", corrected)):
        for k, c in enumerate(machine.command):
            name = column(f"{prefix}{c.name}", c.unit)
            columns[name] = _displayed(block[:, k], c.unit)
    for prefix, block in (("", joints), ("correction_", added)):
        for k, joint in enumerate(machine.joints):
            name = column(f"{prefix}{joint.name}", joint.unit)
            columns[name] = _displayed(block[:, k], joint.unit)
    return columns | _offset_columns(compensation, command)


def _offset_columns(
    compensation: Compensation, command: Array
) -> dict[str, list[float]]:
    """Offsets for additional axes at commands (n, n_dof), by column."""
    further = compensation.further
    if not len(further):
        return {}
    offsets = further.offsets(command, compensation.identified.values)
    return {
        name: [float(v) for v in units.from_si(offsets[:, k], unit)]
        for k, (name, unit) in enumerate(offset_names(compensation))
    }


def offset_names(compensation: Compensation) -> list[tuple[str, str]]:
    """Columns of the offsets for additional axes, `x_offset_um`, with their units."""
    fine = [(axis.name, units.FINE[axis.unit]) for axis in compensation.further.axes]
    return [(f"{name}_offset_{unit}", unit) for name, unit in fine]


def columns_about(compensation: Compensation) -> dict[str, str]:
    """What each column of the table holds, in words."""
    machine = compensation.machine
    about = {}
    for c in machine.command:
        about[column(c.name, c.unit)] = _column_text("command", c.about)
    for c in machine.command:
        about[column(f"corrected_{c.name}", c.unit)] = (
            f"{c.name} to send instead, to a controller with the nominal model"
        )
    for joint in machine.joints:
        about[column(joint.name, joint.unit)] = _column_text(
            "joint that holds the command", joint.about
        )
    whole = ""
    if compensation.held:
        whole = f"; replaces what the controller holds ({compensation.held})"
    for joint in machine.joints:
        about[column(f"correction_{joint.name}", joint.unit)] = (
            f"to add to {joint.name} of the nominal model; interpolate linearly{whole}"
        )
    axes = zip(offset_names(compensation), compensation.further.axes, strict=True)
    for (name, _), axis in axes:
        about[name] = (
            f"{axis.about}, that stays with these joints, actual less nominal; a further"
            " axis takes it back, a table with the workpiece follows it"
        )
    return about


def _column_text(role: str, phrase: str) -> str:
    return f"{role}: {phrase}" if phrase else role


def grid_rows(compensation: Compensation) -> list[dict[str, Any]]:
    """The axes of the table, in order of its columns, and whether each is a full turn."""
    if compensation.grid is None:
        return []
    grid = compensation.grid
    rows = []
    for axis, knots in zip(grid.axes, grid.knots, strict=True):
        places = _displayed(knots, axis.unit)
        rows.append(
            {
                "coordinate": column(axis.name, axis.unit),
                "first": places[0],
                "last": places[-1],
                "count": len(places),
                "repeats": axis.turn,
            }
        )
    return rows


def _displayed(values: Array, si: str) -> list[float]:
    return [float(v) for v in units.from_si(values, display_unit(si))]


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Joints of a controller that computes with these parameters."""
    parameters = json.loads(texts[".json"])["parameters"]
    node_commands = [
        units.to_si(parameters[p.name]["value"], parameters[p.name]["unit"])
        for p in compensation.machine.parameters
    ]
    return compensated_joints(
        compensation.kinematics, compensation.command, np.array(node_commands)
    )


def offsets(texts: Texts, compensation: Compensation) -> Array:
    """Offsets for additional axes, as the table has them, SI."""
    columns = json.loads(texts[".json"])["table"]
    names = offset_names(compensation)
    return np.column_stack([units.to_si(columns[name], unit) for name, unit in names])


controller = ControllerFormat(
    name="json",
    about="parameters with sd, corrected commands and joints, full precision",
    source="this project",
    write=write,
    joints=joints,
    offsets=offsets,
    tables=True,
    table=True,
)
