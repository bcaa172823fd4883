"""RepRapFirmware: a five-bar, M669 K9, with places measured in its plane, in and out.

Cranks count from x to y; at its switch each counts as at its angle of M669 B. L says on which
side of the lines to the tool the knees are: 1 behind both by the sense of the angles, 4 ahead
of both, 2 ahead on the left alone. The nozzle is where the struts meet. A CSV has the
commanded places x, y and those measured, read_x, read_y, mm, in a frame of their own.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from oed import units
from oed.base import Array
from pkm_printers import gcode, words
from pkm_printers.delta_numbers import retained_words
from pkm_printers.delta_study import controller_text
from pkm_printers.gcode import Command
from pkm_printers.rrf_rotary import OF_DELTAS
from pkm_printers.rrf_sequence import WORDS, execution_order
from pkm_printers.words import HARMLESS, READ, WordTable, same
from pkm_studies.base import InputError
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.importers import (
    ImportedSession,
    ImportRequest,
    Model,
    imported_study,
    read_tables,
)
from pkm_studies.tables import ControllerTable, MachineTable

KINEMATICS: Final = "9"
MODEL: Final = "five_bar"
#: sides of the knees, and angles at the switches without B, deg, by M669 L
SIDES: Final = {"1": (-1.0, -1.0), "2": (1.0, -1.0), "4": (1.0, 1.0)}
USUAL_SWITCHES: Final = {"1": "20:10", "2": "110:20", "4": "110:100"}
KEPT: Final = "LACZST"  #: words of M669 that the fit leaves as they are
FIVE_BAR_WORDS: Final[WordTable] = {
    **WORDS,
    **{name: {"": OF_DELTAS} for name in ("M665", "M666")},
    "M669": {**same(READ, "KXYPDLB"), **same(HARMLESS, "ACZST")},
}
COLUMNS: Final = ("x", "y", "read_x", "read_y")
SETUP: Final = {
    "name": "places",
    "instrument": "planar_position",
    # a scanner or a table's ruler lies anywhere, roughly along x
    "tolerance": {"shift_x_mm": 100.0, "shift_y_mm": 100.0, "turn_z_deg": 10.0},
}
NOISE: Final = {"assumed": True, "read_x_mm": 0.1, "read_y_mm": 0.1}
PRIOR: Final = """
# How far the true numbers may be from those of the firmware (standard deviations).
[[prior.tolerance]]
parameters = ["b*", "r*", "l*"]
sigma_mm = 1.0

[[prior.tolerance]]
parameters = ["zero*"]
sigma_deg = 2.0

"""
NOTE: Final = "for config.g of RepRapFirmware 3, in place of its M669"


class _Linkage(NamedTuple):
    """Centres (2, 2), cranks (2,), struts (2,) and sides (2,), mm; switches (2,), deg."""

    centres: Array
    cranks: Array
    struts: Array
    sides: Array
    switches: Array

    @np.errstate(invalid="ignore")
    def turns(self, places: Array) -> Array:
        """Turns (n, 2) of the cranks from their switches, deg; NaN out of reach."""
        away = places[:, None] - self.centres
        reach = np.linalg.norm(away, axis=2)
        square = reach**2 + self.cranks**2 - self.struts**2
        turn = self.sides * np.arccos(square / (2.0 * self.cranks * reach))
        angle = np.arctan2(away[..., 1], away[..., 0]) + turn
        return np.asarray(np.degrees(angle) - self.switches)


def five_bar_session(request: ImportRequest, tables: Sequence[Path]) -> ImportedSession:
    """Geometry of M669 and places of the CSV. Raises InputError."""
    texts = gcode.read([path for path in request.files if path not in tables])
    order = execution_order(texts, FIVE_BAR_WORDS)
    account = gcode.account_of(order.lines, FIVE_BAR_WORDS)
    command = gcode.merged(order.lines, "M669", "give config.g")
    linkage = _linkage(command)
    places, measured = _places(tables, linkage)
    middle = np.ptp(places, axis=0) / 2.0 + places.min(axis=0)
    table = MachineTable(
        model=MODEL,
        nominal={f"zero{i}_deg": v for i, v in enumerate(linkage.switches.tolist(), 1)},
        geometry={
            "centre_mm": linkage.centres.tolist(),
            "crank_mm": linkage.cranks.tolist(),
            "strut_mm": linkage.struts.tolist(),
            "side": linkage.sides.tolist(),
            "home_mm": middle.tolist(),
            "reach_mm": float(np.ptp(places, axis=0).max() / 2.0),
        },
    )
    notes = [*order.notes, *account]
    text = imported_study(
        request,
        Model.from_table(table, request.consent),
        "Five-bar",
        [SETUP],
        NOISE,
        "best_fit",
    )
    controller = ControllerTable(firmware="rrf", keep={"M669": command.text_of(KEPT)})
    rows = [
        {"setup": "places", "run": "1", "order": str(k + 1)}
        | {f"{c}_mm": repr(v) for c, v in zip(COLUMNS, row, strict=True)}
        for k, row in enumerate(np.hstack([places, measured]).tolist())
    ]
    return ImportedSession(
        study=words.comments(notes) + text + PRIOR + controller_text(controller),
        rows=rows,
        statements=[f"Readings: {len(rows)} places as set-up places.", *notes],
    )


def _linkage(command: Command) -> _Linkage:
    """The linkage of M669. Raises InputError."""
    mode = command.words.get("L", "1")
    if mode not in SIDES:
        problem = "the firmware has the modes 1, 2 and 4 alone"
        remedy = "give the L that the printer has"
        raise command.line_of("L").error(problem, remedy, "M669 L")
    struts = command.values("D", 2, 4)
    if any(struts[2:]):
        raise command.line_of("D").error(
            "a strut reaches beyond the joint to the nozzle, which the model has not",
            "describe the machine by a study of your own",
            "M669 D",
        )
    switches = Command(
        "M669", {"B": USUAL_SWITCHES[mode]} | command.words, command.line
    )
    return _Linkage(
        centres=np.column_stack([command.values("X", 2), command.values("Y", 2)]),
        cranks=np.array(command.values("P", 2)),
        struts=np.array(struts[:2]),
        sides=np.array(SIDES[mode]),
        switches=np.array(switches.values("B", 2)),
    )


def _places(tables: Sequence[Path], linkage: _Linkage) -> tuple[Array, Array]:
    """Commanded and measured places, each (n, 2), mm. Raises InputError."""
    if len(tables) != 1:
        columns = ", ".join(COLUMNS)
        problem = f"{len(tables)} CSV files, where one has the measured places"
        raise InputError(problem, f"give one CSV with {columns} in mm", file="FILE")
    (table,) = read_tables(tables)
    cells = np.column_stack([table.numbers(name) for name in COLUMNS])
    outside = np.flatnonzero(np.isnan(linkage.turns(cells[:, :2])).any(axis=1))
    if len(outside):
        problem = "the arms of M669 do not reach this place"
        raise table.error(int(outside[0]), "x", problem, "correct it, or M669")
    return cells[:, :2], cells[:, 2:]


def _write(compensation: Compensation) -> Texts:
    """M669 with four decimals of mm and five of degrees."""

    def read(stem: str, unit: str) -> list[float]:
        values = [compensation.parameter(stem.format(i)) for i in (1, 2)]
        return list(units.from_si(np.array(values), unit))

    retained = retained_words(compensation, "rrf", "M669")
    lengths = {"X": "b{}x", "Y": "b{}y", "P": "r{}", "D": "l{}"}
    stated = {k: [f"{v:.4f}" for v in read(stem, "mm")] for k, stem in lengths.items()}
    stated["D"] += ["0", "0"]  # the firmware asks for four
    stated["B"] = [f"{v:.5f}" for v in read("zero{}", "deg")]
    phrases = [f"{k}{':'.join(cells)}" for k, cells in stated.items()]
    line = " ".join([f"M669 K{KINEMATICS}", *phrases, retained]).rstrip()
    return {".g": compensation.commented(";", [line])}


def _joints(texts: Texts, compensation: Compensation) -> Array:
    """Turns of a printer with this command, nearest to those of the study."""
    linkage = _linkage(gcode.merged(gcode.lines_of(texts[".g"]), "M669", ""))
    places = units.from_si(compensation.command, "mm")
    turns = np.radians(linkage.turns(places))
    _, nearest = compensation.kinematics.inverse(compensation.command)
    return np.asarray(turns - 2.0 * np.pi * np.round((turns - nearest) / (2.0 * np.pi)))


five_bar_format = ControllerFormat(
    name="rrf",
    about="M669 K9 of a five-bar",
    source="RepRapFirmware, src/Movement/Kinematics/FiveBarScaraKinematics.cpp",
    write=_write,
    joints=_joints,
    notes=lambda compensation: (NOTE,),
)
