"""Hangprinter: anchors and spools of M669 and M666, motor angles, places by a camera.

A CSV with the columns A, B, C, D has the motors' angles since the origin, deg, one pose a
line; a CSV with x, y, z has where the mover was, mm, at the first of these poses. Four
lines are one more than the place needs, so every pose counts as a reading of the lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_printers import gcode, words
from pkm_printers.gcode import Command
from pkm_printers.rrf_sequence import execution_order
from pkm_printers.words import HARMLESS, READ, Word, WordTable, costs, refused, same
from pkm_studies.base import InputError, Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import (
    ImportedSession,
    ImportRequest,
    Model,
    Row,
    imported_study,
    read_tables,
)
from pkm_studies.resolve import described_machine
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Origin

MOTORS: Final = "ABCD"
MODEL: Final = "cable_robot"
#: what the model has built in, by letter of M666
BUILT_IN: Final = {
    "U": (2.0, 2.0, 2.0, 4.0),
    "H": (255.0,) * 4,
    "L": (20.0,) * 4,
    "O": (1.0,) * 4,
}
MORE_LINES: Final = refused(
    "the model has four lines, A to D", "describe the machine by a study of your own"
)
M669: Final[dict[str, Word]] = {
    **same(READ, MOTORS),
    "K": READ,
    **same(HARMLESS, "NPSTRF"),
    **same(MORE_LINES, "IJ"),
}
M666: Final[dict[str, Word]] = {
    **same(READ, "RQUHLO"),
    **same(costs("lines of the model do not stretch"), "WSGX"),
    **same(HARMLESS, "AFJT"),
}
WORDS: Final[WordTable] = {
    "M669": M669,
    "M666": M666,
    "G20": {"": refused("the numbers are in inches", "give them in mm")},
}
#: mm; no anchor is farther away
LARGEST: Final = 1e6
NOISE: Final = {
    "assumed": True,
    **{f"read_{axis}_mm": 1.0 for axis in "xyz"},
    "gap_mm": 0.5,
}
#: share of the nearest anchor's distance within which all poses say nothing of a machine
NEAR_ORIGIN = 0.02
#: factor between recorded and expected angles from which on they are no such angles
OTHER_UNIT_FACTOR = 1.5


class HangprinterImporter:
    """Reads config.g, the motors' CSV and the places' CSV, in any order."""

    name = "hangprinter"
    about = (
        "Hangprinter: config.g (M669, M666), CSV of motors A, B, C, D, CSV of x, y, z"
    )
    unused = ("--machine", "--map", "--mesh")

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry, motors and places. Raises InputError."""
        tables = read_tables([path for path in request.files if _is_csv(path)])
        texts = gcode.read([path for path in request.files if not _is_csv(path)])
        order = execution_order(texts, WORDS)
        lines = order.lines
        anchors = gcode.merged(lines, "M669", "give config.g with M669 and M666")
        spools = gcode.merged(lines, "M666", "give config.g with M669 and M666")
        accounts = [
            *order.notes,
            *gcode.order_text(texts),
            *gcode.account_of(lines, WORDS).sentences(),
        ]
        _check_built_in(spools)
        _check_tables(tables, request.files)
        motors, places = _motors(tables), _places(tables)
        if len(places) > len(motors):
            problem = f"{len(places)} places, but {len(motors)} poses of the motors"
            raise InputError(problem, "give the motors of each place", file="x, y, z")
        table = MachineTable(
            model=MODEL,
            nominal=_nominal(anchors, spools),
            geometry={"buildup_mm": _numbers(spools, "Q")[0]},
        )
        machine = described_machine(
            table, Origin.command(request.consent), Location("")
        )
        file = next(t.file for t in tables if set(MOTORS) <= set(t.header))
        check_motor_unit(machine, motors, places, file)
        setups = [{"name": "lines", "instrument": "redundancy"}]
        if len(places):
            setups.append({"name": "camera", "instrument": "camera_known_frame"})
        text = imported_study(
            request,
            Model(machine, table),
            "Hangprinter",
            setups,
            NOISE if len(places) else {"assumed": True, "gap_mm": 0.5},
            "home" if len(places) else "best_fit",
        )
        statements = [
            f"Readings: four lines at {len(motors)} poses as set-up lines.",
            *_camera_sentences(places),
            *accounts,
        ]
        return ImportedSession(
            study=words.comments(accounts) + text,
            rows=_rows(motors, places),
            statements=statements,
        )


importer = HangprinterImporter()


def _is_csv(path: Path) -> bool:
    return path.suffix.lower() == ".csv"


def _numbers(command: Command, letter: str) -> list[float]:
    """Numbers of a word, separated by colons. Raises InputError."""
    text = command.words.get(letter)
    if not text:
        problem = f"{command.name} has no {letter}"
        raise command.line.error(problem, "give the full command")
    line = command.line_of(letter)
    return [gcode.finite(cell, line) for cell in text.split(":")]


def _check_built_in(spools: Command) -> None:
    """Refuse gears and folds other than the model's. Raises InputError."""
    for letter, wanted in BUILT_IN.items():
        if letter not in spools.words:
            continue
        stated = _numbers(spools, letter)
        if not np.allclose(stated, wanted[: len(stated)], rtol=1e-6):
            listed = ":".join(f"{value:g}" for value in wanted)
            raise spools.line_of(letter).error(
                f"the model {MODEL} has {letter}{listed} built in",
                "describe another machine by a study of your own",
                f"M666 {letter}",
            )


def _nominal(anchors: Command, spools: Command) -> dict[str, float]:
    """Anchors, spools and lines of the machine, mm. Raises InputError."""
    nominal = {}
    radii = _numbers(spools, "R")
    if len(radii) != len(MOTORS):
        raise spools.line_of("R").error(
            "R needs four radii", "give the full command", "M666 R"
        )
    for i, motor in enumerate(MOTORS, start=1):
        location = _numbers(anchors, motor)
        if len(location) == 1:  # the upper anchor of three-number versions: its height
            location = [0.0, 0.0, *location]
        if len(location) != len("xyz") or np.abs(location).max() > LARGEST:
            problem = "an anchor has x, y and z, in mm"
            raise anchors.line_of(motor).error(
                problem, "give the full command", f"M669 {motor}"
            )
        for axis, value in zip("xyz", location, strict=True):
            nominal[f"anchor{i}{axis}_mm"] = value
        nominal[f"radius{i}_mm"] = radii[i - 1]
        nominal[f"line{i}_mm"] = round(float(np.linalg.norm(location)), 6)
    return nominal


def _camera_sentences(places: Array) -> list[str]:
    if not len(places):
        return []
    return [f"Readings: {len(places)} places of the first poses as set-up camera."]


def _check_tables(tables: Sequence[CsvTable], paths: Sequence[Path]) -> None:
    """Refuse tables that are neither, and two of one kind. Raises InputError."""
    files = [str(path) for path in paths if _is_csv(path)]
    kinds: dict[str, str] = {}
    for table, file in zip(tables, files, strict=True):
        header = set(table.header)
        kind = next((k for k in (MOTORS, "xyz") if set(k) <= header), "")
        if not kind or kind in kinds:
            raise InputError(
                f"{kinds[kind]} has the columns {', '.join(kind)} too"
                if kind
                else f"its columns are {', '.join(table.header)}",
                "give one CSV with A, B, C, D, and one with x, y, z at most",
                file=file,
            )
        kinds[kind] = file


def _motors(tables: Sequence[CsvTable]) -> Array:
    """Angles (n, 4) of the motors, deg. Raises InputError."""
    for table in tables:
        if set(MOTORS) <= set(table.header):
            return np.column_stack([table.numbers(motor) for motor in MOTORS])
    raise InputError(
        "no motor angles", "give a CSV with the columns A, B, C, D in deg", file="FILE"
    )


def _places(tables: Sequence[CsvTable]) -> Array:
    """Places (n, 3) of the mover, mm; none where no file has them."""
    for table in tables:
        if set("xyz") <= set(table.header):
            return np.column_stack([table.numbers(axis) for axis in "xyz"])
    return np.zeros((0, 3))


def _rows(motors: Array, places: Array) -> list[Row]:
    """Rows of the readings file: the camera's, then the lines'."""
    joints = [
        {f"q{i}_deg": repr(float(v)) for i, v in enumerate(row, start=1)}
        for row in motors
    ]
    rows: list[Row] = []
    for k, location in enumerate(places):
        label = {"setup": "camera", "run": "1", "order": str(k + 1)}
        read = {
            f"read_{axis}_mm": repr(float(value))
            for axis, value in zip("xyz", location, strict=True)
        }
        rows.append(label | joints[k] | read)
    for k, pose in enumerate(joints):
        label = {"setup": "lines", "run": "1", "order": str(k + 1)}
        rows.append(label | pose | {"gap_mm": "0"})
    return rows


# -- whether motor angles are degrees --------------------------------------------------


def check_motor_unit(machine: Machine, motors: Array, places: Array, file: str) -> None:
    """Raises InputError where the motors do not turn as the places and lines want.

    motors  (n, 4) angles, deg
    places  (k, 3) of the mover at the first of these poses, mm; may be none
    """
    kinematics = Kinematics(machine)
    if len(places):
        expected = np.degrees(kinematics.inverse(places / 1e3)[1])
        _check_motor_factor(motors[: len(places)], expected, file)
        return
    anchors = [p.nominal for p in machine.parameters if p.name.startswith("anchor")]
    distances = np.linalg.norm(np.reshape(anchors, (-1, 3)), axis=1)
    around = NEAR_ORIGIN * distances.min() * np.vstack([np.eye(3), -np.eye(3)])
    least = np.abs(np.degrees(kinematics.inverse(around)[1])).max()
    if np.abs(motors).max() < least:
        raise _motor_refusal(
            f"no motor turns by more than {np.abs(motors).max():.3g} deg, which moves the"
            f" lines by less than {1e3 * NEAR_ORIGIN * distances.min():.3g} mm",
            file,
        )


def _check_motor_factor(motors: Array, expected: Array, file: str) -> None:
    """Raises InputError where angles (k, 4) are a multiple of the expected ones, deg."""
    square = float(np.sum(expected**2))
    if square == 0.0:
        return
    factor = float(np.sum(motors * expected)) / square
    if 1.0 / OTHER_UNIT_FACTOR < factor < OTHER_UNIT_FACTOR:
        return
    raise _motor_refusal(
        f"the motors turn by {factor:.3g} times what the places and M669, M666 give",
        file,
    )


def _motor_refusal(problem: str, file: str) -> InputError:
    return InputError(
        problem,
        "give degrees since the origin, positive where a line is paid out; radians times"
        " 57.2958",
        file=file,
        field="A, B, C, D",
    )
