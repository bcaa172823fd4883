"""CSV: a table of corrected commands and joints, its axes, and parameters."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from oed import csv_text, units
from oed.base import Array
from oed.result import EffectTable
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.compensation.formats.json_file import (
    columns_about,
    grid_rows,
    offset_names,
    table,
)
from pkm_studies.quantities import column

COMMAND_DECIMALS = 6  #: decimals of lengths in mm and of angles in degrees
PARAMETER_DIGITS = 12  #: significant digits of parameters


def write(compensation: Compensation) -> Texts:
    """The table first; its columns, axes, parameters and effects in further files."""
    columns = table(compensation)
    rows = zip(*columns.values(), strict=True)
    commands = ([f"{value:.{COMMAND_DECIMALS}f}" for value in row] for row in rows)
    texts = {
        ".csv": _text(list(columns), commands),
        "_parameters.csv": _text(
            ["name", "value", "sd", "nominal", "unit", "about"],
            _parameters(compensation),
        ),
        "_columns.csv": _text(
            ["column", "about"], map(list, columns_about(compensation).items())
        ),
    }
    axes = grid_rows(compensation)
    if axes:
        texts["_grid.csv"] = _text(list(axes[0]), map(_axis, axes))
    if compensation.tables:
        first = compensation.tables[0]
        header = ["effect", "state", "value", *first.commands[0], *first.joints]
        texts["_effects.csv"] = _text(header, _effects(compensation.tables))
    return texts


def _axis(row: Mapping[str, Any]) -> list[str]:
    numbers = [f"{row[end]:.{COMMAND_DECIMALS}f}" for end in ("first", "last")]
    repeats = "yes" if row["repeats"] else "no"
    return [row["coordinate"], *numbers, str(row["count"]), repeats]


def _parameters(compensation: Compensation) -> Iterable[list[str]]:
    identified = compensation.identified
    for k, p in enumerate(compensation.machine.parameters):
        unit = units.display(p.unit)
        numbers = (identified.values[k], identified.sd[k], p.nominal)
        texts = [
            f"{units.number(value, unit):.{PARAMETER_DIGITS}g}" for value in numbers
        ]
        yield [p.name, *texts, unit, p.about]


def _effects(tables: Sequence[EffectTable]) -> Iterable[list[str]]:
    """One row for each effect, state and command: joint corrections to add."""
    for t in tables:
        for value, rows in zip(t.values, t.table, strict=True):
            for command, offsets in zip(t.commands, rows, strict=True):
                location = [f"{v:.{COMMAND_DECIMALS}f}" for v in command.values()]
                corrections = [f"{v:.{COMMAND_DECIMALS}f}" for v in offsets]
                yield [
                    t.effect,
                    t.state,
                    f"{value:.{PARAMETER_DIGITS}g}",
                    *location,
                    *corrections,
                ]


def _text(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return csv_text.of_rows([header, *rows])


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Joints as the table has them."""
    names = [column(joint.name, joint.unit) for joint in compensation.machine.joints]
    return _stated(texts, names)


def offsets(texts: Texts, compensation: Compensation) -> Array:
    """Offsets for additional axes, as the table has them, SI."""
    return _stated(texts, [name for name, _ in offset_names(compensation)])


def _stated(texts: Texts, names: Sequence[str]) -> Array:
    """Columns (n, k) of the table by their names, SI."""
    rows = list(csv.DictReader(io.StringIO(texts[".csv"])))
    columns = [
        units.to_si([float(row[name]) for row in rows], units.split(name)[1])
        for name in names
    ]
    return np.column_stack(columns)


controller = ControllerFormat(
    name="csv",
    about="corrections over a grid of commands, and parameters, six decimals",
    source="this project",
    write=write,
    joints=joints,
    offsets=offsets,
    tables=True,
    table=True,
    interpolated=True,
)
