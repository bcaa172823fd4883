"""What a user's own header says: `x`, `measured x (mm)`, `belt 2`, `tl`, `distance`.

A name is a quantity with, at will, a unit and a word that says whether it was commanded or
measured. Lengths without a unit are mm, angles degrees.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

import numpy as np

from oed.dataset import UNITLESS, is_remark
from oed.model import Machine
from oed.units import UNITS
from pkm_studies.base import InputError
from pkm_studies.csv_table import CsvTable
from pkm_studies.quantities import column as usual_column

WORD: Final = re.compile(r"[a-z]+|\d+")
MEASURED: Final = {"measured", "meas", "read", "actual", "real", "probed"}
COMMANDED: Final = {"commanded", "command", "cmd", "set", "target", "nominal"}
#: words for a driven joint, before its number
JOINT: Final = {"q", "belt", "cable", "chain", "leg", "line", "motor", "length", "l"}
#: words for a reading that is neither a coordinate nor a joint, by its channel
CHANNELS: Final = {
    "distance": "length",
    "dist": "length",
    "length": "length",
    "height": "height",
}
#: ends of a measured distance, as in x1, y1, x2, y2
ENDS: Final = ("1", "2")


def quantities(table: CsvTable, machine: Machine) -> dict[str, str]:
    """Column of the readings by column of the file; ends of distances as `x1_mm`, `x2_mm`.

    Remarks are left out. Raises InputError for a name that is no quantity of the machine.
    """
    meanings = _meanings(machine)
    stems: dict[str, str] = {}
    for name in table.header:
        if is_remark(name) or name in UNITLESS:
            continue
        stem = _column(name, meanings)
        if stem is None or stem in stems.values():
            problem = "no quantity of this machine" if stem is None else "read twice"
            raise InputError(
                problem,
                f"write {_possible(machine)}, or take the column out; a map of"
                " `oed import columns` names any column",
                file=table.file,
                field="header",
                value=name,
            )
        stems[name] = stem
    return stems


def _meanings(machine: Machine) -> dict[str, tuple[str, str]]:
    """Stem and SI unit of a quantity, by its words without a unit."""
    meanings = {word: (channel, "m") for word, channel in CHANNELS.items()}
    for c in machine.command:
        meanings[_key(c.name)] = (c.name, c.unit)
        ends = {f"{_key(c.name)} {end}": (f"{c.name}{end}", c.unit) for end in ENDS}
        meanings |= ends
    for axis in "xyz":
        meanings[f"measured {axis}"] = (f"read_{axis}", "m")
    for k, joint in enumerate(machine.joints, start=1):
        meanings |= {f"{word} {k}": (joint.name, joint.unit) for word in JOINT}
        meanings[_key(joint.name)] = (joint.name, joint.unit)
    return meanings | _corners(machine)


def _corners(machine: Machine) -> dict[str, tuple[str, str]]:
    """Joints of four cables in a plane by the corner of their anchor, such as `tl`."""
    nominal = {p.name: p.nominal for p in machine.parameters}
    if len(machine.joints) != 4 or "anchor4y" not in nominal or "anchor4z" in nominal:
        return {}
    places = np.array([[nominal[f"anchor{k}{a}"] for a in "xy"] for k in range(1, 5)])
    right, top = (places > places.mean(axis=0)).T
    return {
        f"{'bt'[int(top[k])]}{'lr'[int(right[k])]}": (joint.name, joint.unit)
        for k, joint in enumerate(machine.joints)
    }


def _column(name: str, meanings: Mapping[str, tuple[str, str]]) -> str | None:
    """Column of the readings of a name of the header; None for no quantity."""
    words = _key(name).split()
    units = [word for word in words[1:] if word in UNITS and not word.isdigit()]
    plain = " ".join(w for w in words if w not in {*units, *COMMANDED, *MEASURED})
    is_point = bool(MEASURED & set(words)) and plain not in CHANNELS
    key = f"measured {plain}" if is_point else plain
    if key not in meanings or len(units) > 1:
        return None
    stem, unit = meanings[key]
    if not units:
        return usual_column(stem, unit)
    return f"{stem}_{units[0]}" if UNITS[units[0]][0] == unit else None


def _key(name: str) -> str:
    """The words of a name, letters and numbers apart: `X1_mm` is `x 1 mm`."""
    return " ".join(WORD.findall(name.lower()))


def _possible(machine: Machine) -> str:
    names = [c.name for c in (*machine.command, *machine.joints)]
    return f"{', '.join(names)}, measured x, measured y, measured z, height or distance"
