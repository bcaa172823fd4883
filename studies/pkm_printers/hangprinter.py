"""Hangprinter: anchors and spools of M669 and M666, motor angles, places by a camera.

A CSV with a column for each anchor, A, B, C, D, has the motors' angles since the origin, deg,
one pose a line; columns FA, FB, ... the forces, N, beyond those at the origin. A CSV with x,
y, z has where the mover was, mm, at the first of these poses. Each line more than three is
more than the place needs, so that every pose counts as a reading of the lines.

The firmware turns a motor by k0 (sqrt(R^2 + k2 l) - R) for a line that is l longer than at
the origin, k2 = -U O Q. A force F makes it F (U d + Y) / (S U) longer, d from the anchor.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_printers import gcode, words
from pkm_printers.delta_numbers import retained_words
from pkm_printers.delta_study import controller_text
from pkm_printers.gcode import Command
from pkm_printers.rrf_sequence import execution_order
from pkm_printers.words import HARMLESS, READ, Word, WordTable, costs, refused, same
from pkm_studies.base import InputError
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import (
    ImportedSession,
    ImportRequest,
    Model,
    Row,
    imported_study,
    read_tables,
)
from pkm_studies.tables import ControllerTable, MachineTable

LETTERS: Final = "ABCDI"  #: letters of the anchors in the firmware's order
MODEL: Final = "cable_robot"
#: words of M666 that the firmware has without, by line
USUAL: Final = {"H": 255.0, "L": 20.0, "O": 1.0}
#: words that are identified, or written in any case; others are written back as they are
WRITTEN: Final = f"{LETTERS}KN", "QR"
ACROSS = 0.25  #: share of the nearest anchor's distance that the workspace spans across
UP = 0.6  #: share of the highest anchor's height that it spans upward
MORE_LINES: Final = refused(
    "the firmware has five anchors at most, A to D and I", "remove it from a copy"
)
FLEX: Final = costs(
    "it is how the firmware plans forces for its flex compensation, and stays as it is"
)
M669: Final[dict[str, Word]] = {
    **same(READ, f"{LETTERS}KN"),
    **same(HARMLESS, "PSTRF"),
    **same(MORE_LINES, "JLO"),
}
M666: Final[dict[str, Word]] = {
    **same(READ, "RQUHLOSY"),
    **same(FLEX, "WITX"),
    **same(HARMLESS, "AFJCG"),
}
WORDS: Final[WordTable] = {
    "M669": M669,
    "M666": M666,
    "G20": {"": refused("the numbers are in inches", "give them in mm")},
}
MAX_ANCHOR_MM: Final = 1e6  #: mm; no anchor is farther away
PLACE_NOISE: Final = {f"read_{axis}_mm": 1.0 for axis in "xyz"}
GAP_MM: Final = 0.5
#: share of the nearest anchor's distance within which all poses say nothing of a machine
NEAR_ORIGIN = 0.02
#: factor between recorded and expected angles from which on they are no such angles
OTHER_UNIT_FACTOR = 1.5


class HangprinterImporter:
    """Reads config.g, the motors' CSV and the places' CSV, in any order."""

    name = "hangprinter"
    about = (
        "Hangprinter: config.g (M669, M666), CSV of motors A, B, C, ..., CSV of x, y, z"
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
            *gcode.account_of(lines, WORDS),
        ]
        table = machine_table(anchors, spools)
        motors = _letters(anchors)
        _check_tables(tables, request.files, motors)
        turns, places = _cells(tables, motors), _cells(tables, "xyz")
        if len(places) > len(turns):
            problem = f"{len(places)} places, but {len(turns)} poses of the motors"
            raise InputError(problem, "give the motors of each place", file="x, y, z")
        model = Model.from_table(table, request.consent)
        file = next(t.file for t in tables if set(motors) <= set(t.header))
        check_motor_unit(model.machine, turns, places, file)
        text = imported_study(
            request,
            model,
            "Hangprinter",
            *_setups(len(motors), len(places)),
            "home" if len(places) else "best_fit",
        )
        forces = _cells(tables, [f"F{motor}" for motor in motors])
        keep = {
            c.name: c.text_of(k for k in c.words if k not in letters)
            for c, letters in zip((anchors, spools), WRITTEN, strict=True)
        }
        controller = ControllerTable(firmware="rrf", keep=keep)
        statements = [
            f"Readings: {len(motors)} lines at {len(turns)} poses as set-up lines."
            if len(motors) > len("xyz")
            else "Readings: three lines are no more than the place needs.",
            *_camera_sentences(places),
            *accounts,
        ]
        return ImportedSession(
            study=words.comments(accounts) + text + controller_text(controller),
            rows=_rows(turns, places, forces),
            statements=statements,
        )


importer = HangprinterImporter()


def _is_csv(path: Path) -> bool:
    return path.suffix.lower() == ".csv"


def _letters(anchors: Command) -> str:
    """Letters of the anchors, as many as N. Raises InputError."""
    stated = "".join(letter for letter in LETTERS if letter in anchors.words)
    count = int(anchors.number("N", max(len(stated), len("xyz"))))
    if not len("xyz") <= count <= len(LETTERS) or stated != LETTERS[:count]:
        problem = f"{count} anchors are stated as {', '.join(stated)}"
        remedy = "give three to five, as N says: A, B, C, D, I in this order"
        raise anchors.line_of("N").error(problem, remedy, "M669 N")
    return stated


def machine_table(anchors: Command, spools: Command) -> MachineTable:
    """Anchors, spools and lines of the machine. Raises InputError."""
    letters = _letters(anchors)
    places = np.array([_anchor(anchors, letter) for letter in letters])
    distance = np.linalg.norm(places, axis=1)
    numbers = {k: np.array(spools.values(k, len(letters))) for k in "RU"}
    for letter, usual in USUAL.items():
        is_stated = letter in spools.words
        cells = (
            spools.values(letter, len(letters)) if is_stated else [usual] * len(places)
        )
        numbers[letter] = np.array(cells)
    if np.ptp(numbers["O"]):
        problem = "the spools hold different numbers of lines"
        remedy = "describe the machine by a study of your own"
        raise spools.line_of("O").error(problem, remedy, "M666 O")
    geometry: dict[str, Any] = {
        "anchor_mm": places.tolist(),
        "fold": numbers["U"].tolist(),
        "gear": (numbers["H"] / numbers["L"]).tolist(),
        "buildup_mm": spools.values("Q", 1)[0] * float(numbers["O"][0]),
        "zeroed": 1.0,
    }
    if "S" in spools.words:
        beyond = _guy_wires(places, spools) / (numbers["U"] * distance)
        geometry["stiffness_N"] = (spools.number("S") / (1.0 + beyond)).tolist()
    across = np.linalg.norm(places[:, :2], axis=1)
    reach = round(ACROSS * float(across[across > 0.0].min()), 1)
    return MachineTable(
        model=MODEL,
        geometry=geometry,
        nominal={f"radius{i}_mm": v for i, v in enumerate(numbers["R"].tolist(), 1)},
        workspace={
            **{f"{axis}_mm": (-reach, reach) for axis in "xy"},
            "z_mm": (0.0, round(UP * float(places[:, 2].max()), 1)),
        },
    )


def _anchor(anchors: Command, letter: str) -> list[float]:
    """Place (3,) of an anchor, mm. Raises InputError."""
    location = anchors.values(letter)
    if len(location) == 1:  # the upper anchor of three-number versions: its height
        location = [0.0, 0.0, *location]
    if len(location) != len("xyz") or np.abs(location).max() > MAX_ANCHOR_MM:
        problem, remedy = "an anchor has x, y and z, in mm", "give the full command"
        raise anchors.line_of(letter).error(problem, remedy, f"M669 {letter}")
    return location


def _guy_wires(places: Array, spools: Command) -> Array:
    """Lengths (n,) of lines from spools, or the last anchor, mm. Raises InputError."""
    if "Y" in spools.words and min(spools.values("Y", len(places))) >= 0.0:
        return np.array(spools.values("Y"))
    return np.asarray(np.linalg.norm(places - places[-1], axis=1))


def _setups(
    lines: int, places: int
) -> tuple[list[Mapping[str, object]], dict[str, object]]:
    """Set-ups and noise of so many lines and places. Raises InputError without any."""
    setups: list[Mapping[str, object]] = []
    noise: dict[str, object] = {"assumed": True}
    spare = lines - len("xyz")
    if spare:
        setups.append({"name": "lines", "instrument": "redundancy"})
        noise |= dict.fromkeys(_gaps(lines), GAP_MM)
    if places:
        setups.append({"name": "camera", "instrument": "camera_known_frame"})
        noise |= PLACE_NOISE
    if not setups:
        problem = "three lines alone say nothing of the machine"
        raise InputError(problem, "give a CSV with x, y, z as well", file="FILE")
    return setups, noise


def _gaps(lines: int) -> list[str]:
    """Columns of what the lines of a machine fail to meet by."""
    spare = lines - len("xyz")
    return ["gap_mm"] if spare == 1 else [f"gap{k}_mm" for k in range(1, spare + 1)]


def _camera_sentences(places: Array) -> list[str]:
    if not len(places):
        return []
    return [f"Readings: {len(places)} places of the first poses as set-up camera."]


def _check_tables(
    tables: Sequence[CsvTable], paths: Sequence[Path], motors: str
) -> None:
    """Refuse tables that are neither, two of one kind, and none. Raises InputError."""
    files = [str(path) for path in paths if _is_csv(path)]
    kinds: dict[str, str] = {}
    for table, file in zip(tables, files, strict=True):
        header = set(table.header)
        kind = next((k for k in (motors, "xyz") if set(k) <= header), "")
        if not kind or kind in kinds:
            raise InputError(
                f"{kinds[kind]} has the columns {', '.join(kind)} too"
                if kind
                else f"its columns are {', '.join(table.header)}",
                f"give one CSV with {', '.join(motors)}, and one with x, y, z at most",
                file=file,
            )
        kinds[kind] = file
    if motors not in kinds:
        remedy = f"give a CSV with the columns {', '.join(motors)} in deg"
        raise InputError("no motor angles", remedy, file="FILE")


def _cells(tables: Sequence[CsvTable], names: Sequence[str]) -> Array:
    """Columns (m, n) of the table that has them all; none (0, n) without."""
    for table in tables:
        if set(names) <= set(table.header):
            return np.column_stack([table.numbers(name) for name in names])
    return np.zeros((0, len(names)))


def _rows(turns: Array, places: Array, forces: Array) -> list[Row]:
    """Rows of the readings file: the camera's, then those of spare lines."""
    poses = [_numbered("q{}_deg", row) for row in turns.tolist()]
    for pose, row in zip(poses, forces.tolist(), strict=False):
        pose |= _numbered("tension_{}_N", row)
    rows: list[Row] = []
    for k, (pose, point) in enumerate(zip(poses, places.tolist(), strict=False), 1):
        label = {"setup": "camera", "run": "1", "order": str(k)}
        read = {f"read_{a}_mm": repr(v) for a, v in zip("xyz", point, strict=True)}
        rows.append(label | pose | read)
    gaps = dict.fromkeys(_gaps(turns.shape[1]), "0")
    for k, pose in enumerate(poses if gaps else [], start=1):
        rows.append({"setup": "lines", "run": "1", "order": str(k)} | pose | gaps)
    return rows


def _numbered(column: str, values: Sequence[float]) -> dict[str, str]:
    return {column.format(i): repr(v) for i, v in enumerate(values, start=1)}


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
        field="motor angles",
    )


# RepRapFirmware: M669 K6 and M666 of a Hangprinter.
#
# The firmware takes the place where all motors are 0 for its origin, so that anchors are
# written as seen from there.

COMMANDS = ("M669", "M666")
NOT_WRITTEN = (
    "S, W, T, X, Y and other words of the flex compensation stay as they are: the study"
    " does not identify them"
)


def _write(compensation: Compensation) -> Texts:
    """Anchors with two decimals of mm more than they are known to, spools and build-up."""
    count = len(compensation.machine.joints)
    anchors = [_place(compensation, f"anchor{i + 1}") for i in range(count)]
    places = np.array(anchors) - _place(compensation, "origin_")
    radii = [compensation.parameter(f"radius{i + 1}") for i in range(count)]
    retained = [retained_words(compensation, "rrf", name) for name in COMMANDS]
    (spool_words,) = gcode.commands(gcode.lines_of(f"M666 {retained[1]}"))
    buildup = compensation.parameter("buildup") / spool_words.number("O", 1.0)
    cells = [":".join(f"{v:.4f}" for v in point) for point in places]
    phrases = [f"{k}{v}" for k, v in zip(LETTERS, cells, strict=False)]
    spools = ":".join(f"{v:.4f}" for v in units.from_si(np.array(radii), "mm"))
    lines = [
        f"M669 K6 N{count} {' '.join(phrases)} {retained[0]}",
        f"M666 Q{units.number(buildup, 'mm'):.6f} R{spools} {retained[1]}",
    ]
    return {".g": compensation.commented(";", lines)}


def _joints(texts: Texts, compensation: Compensation) -> Array:
    """Motor angles of a printer with these commands, without flex."""
    lines = gcode.lines_of(texts[".g"])
    anchors, spools = (gcode.merged(lines, name, "") for name in COMMANDS)
    table = machine_table(anchors, spools)
    places = np.array(table.geometry["anchor_mm"])
    fold, gear = (np.array(table.geometry[k]) for k in ("fold", "gear"))
    radii = np.array([*table.nominal.values()])
    origin = _place(compensation, "origin_")
    commands = units.from_si(compensation.command, "mm") - origin
    distances = np.linalg.norm(commands[:, None] - places, axis=2)
    change = distances - np.linalg.norm(places, axis=1)
    # 2 / k2 (sqrt(r^2 + k2 l) - r), which holds without build-up too
    k2 = -fold * np.array(table.geometry["buildup_mm"])
    turned = 2.0 * change / (np.sqrt(radii**2 + k2 * change) + radii)
    return np.asarray(turned * fold * gear)


def _place(compensation: Compensation, stem: str) -> Array:
    """Three coordinates (3,), mm."""
    values = [compensation.parameter(f"{stem}{axis}") for axis in "xyz"]
    return units.from_si(np.array(values), "mm")


def _notes(compensation: Compensation) -> tuple[str, ...]:
    """What the file is for, where its origin is, and what it does not hold."""
    listed = ", ".join(f"{v:+.2f}" for v in _place(compensation, "origin_"))
    origin = f"the origin is where the motors are 0, {listed} mm in the study's frame"
    return "for config.g, in place of its M669 and M666", origin, NOT_WRITTEN


def _unfit(machine: Machine) -> str | None:
    if "buildup" in {p.name for p in machine.parameters}:
        return None
    return "it writes a Hangprinter whose motors were 0 at one place (zeroed = 1)"


hangprinter_format = ControllerFormat(
    name="rrf",
    about="M669 K6 and M666 of a Hangprinter",
    source="RepRapFirmware, src/Movement/Kinematics/HangprinterKinematics.cpp",
    write=_write,
    joints=_joints,
    unfit=_unfit,
    notes=_notes,
)
