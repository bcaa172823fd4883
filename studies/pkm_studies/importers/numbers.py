"""A user's own numbers: a CSV whose header says what its columns are, and a machine's name.

The instrument follows from what was measured. The machine's numbers are taken for as good
as a tape measure finds them, and the noise for an assumption that the readings replace.
"""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w

from oed import units
from oed.base import Array
from oed.dataset import UNITLESS, is_remark
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Coordinate, Machine
from oed.units import UNITS
from pkm_studies import catalogue
from pkm_studies.base import InputError, Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import column_map, columns, nominal_poses
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row
from pkm_studies.importers.column_map import Model
from pkm_studies.importers.line_times import read_tables
from pkm_studies.importers.map_tables import ColumnMap
from pkm_studies.quantities import column as usual_column
from pkm_studies.user_code import Origin

#: share of the machine's size to which a user knows its places and lengths: some cm of 3 m
RELATIVE_TOLERANCE: Final = 0.01
TAPE_MM: Final = 0.5  #: mm; lengths and places by a tape measure, heights by a probe
PROBE_MM: Final = 0.1
CONTACT: Final = "contact_probe"
REDUNDANCY: Final = "redundancy"
#: share of a range by which joints may pass what the readings need
JOINT_MARGIN_SHARE: Final = 0.1


class NumbersImporter:
    """Takes columns by their plain names; the machine's ranges grow to the readings."""

    name = "numbers"
    about = "your own numbers (CSV): positions, distances, heights or lengths of cables"
    unused = ("--map", "--mesh")

    def read(self, request: ImportRequest) -> ImportedSession:
        """The session in the files. Raises InputError with line and remedy."""
        location = Location("--machine")
        model = column_map.model(request, ColumnMap(), location)
        table = columns.joined(read_tables(request.files))
        stems = quantities(table, model.machine)
        table, stems = _ends_as_rows(table, stems)
        kind = _instrument(set(stems.values()), model.machine, table)
        origin = Origin.command(request.consent)
        tool = catalogue.instrument(kind, origin, location).for_machine(model.machine)
        mapping = ColumnMap(columns={stem: name for name, stem in stems.items()})
        if kind == CONTACT:
            mapping.columns["z_mm"] = mapping.columns.pop("height_mm")
        mapped = columns.mapped_columns(mapping, table, model.machine, tool, location)
        rows = columns.rows(table, mapped, mapping, tool, location)
        model = _widened(model, rows)
        if kind == REDUNDANCY:
            model = _drop_zeros(model)
        setup: dict[str, Any] = columns.setup_table(
            msgspec.structs.replace(mapping, columns=mapped), kind, tool
        )
        is_height = "height" in tool.channels[0].name
        read = setup.get("channels", [c.name for c in tool.channels])
        noise = {f"{c}_mm": PROBE_MM if is_height else TAPE_MM for c in read}
        prior, known = _prior(model.machine)
        session = columns.session(
            request,
            msgspec.structs.replace(mapping, noise={"assumed": True, **noise}),
            model,
            tool,
            setups=[setup],
            rows=rows,
            statements=[
                *columns.statements(table, mapped, mapping, tool, model.machine),
                f"Instrument: {kind}, noise assumed.",
                known,
            ],
            errors="home" if is_height else "best_fit",
        )
        study = f"{session.study}\n{prior}"
        return dataclasses.replace(session, study=study, column_map=None)


importer = NumbersImporter()


def _instrument(stems: set[str], machine: Machine, table: CsvTable) -> str:
    """What was measured with, from columns of the readings. Raises InputError."""
    names = {stem.rpartition("_")[0] for stem in stems}
    if "read_x" in names and "z" not in {c.name for c in machine.pose}:
        return "planar_position"
    if {"read_x", "read_y", "read_z"} & names:
        return "camera"
    if "length" in names:
        return "calliper"
    if "height" in names:
        return "height_probe" if "z" in names else CONTACT
    is_redundant = len(machine.joints) > len(machine.command)
    if is_redundant and {joint.name for joint in machine.joints} <= names:
        return REDUNDANCY
    raise InputError(
        "nothing was measured: all columns are commands or joints",
        "add columns such as measured x, measured y; height; or x1, y1, x2, y2, distance",
        file=table.file,
        field="header",
        value=", ".join(table.header),
    )


def _ends_as_rows(
    table: CsvTable, stems: Mapping[str, str]
) -> tuple[CsvTable, dict[str, str]]:
    """Each measured distance as a run of its two ends. Raises InputError without ends."""
    ends = [
        {s.replace(f"{end}_", "_"): name for name, s in stems.items() if f"{end}_" in s}
        for end in ENDS
    ]
    distance = next((n for n, s in stems.items() if s.startswith("length_")), None)
    if distance is None:
        return table, dict(stems)
    if not ends[0] or set(ends[0]) != set(ends[1]):
        raise InputError(
            "a distance between which two places?",
            "give the commanded ends of each: x1, y1, x2, y2",
            file=table.file,
            field="header",
            value=distance,
        )
    header = ("run", *ends[0], stems[distance])
    index = {name: table.header.index(name) for name in table.header}
    lines = []
    for run, (number, cells) in enumerate(table.lines, start=1):
        for end, length in zip(ends, ("", cells[index[distance]]), strict=True):
            end_cells = [cells[index[end[stem]]] for stem in ends[0]]
            lines.append((number, [str(run), *end_cells, length]))
    return CsvTable(table.file, header, tuple(lines)), {n: n for n in header[1:]}


def _widened(model: Model, rows: list[Row]) -> Model:
    """The machine with workspace and travel that hold the readings too."""
    machine = model.machine
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    values = [
        nominal_poses.si_numbers(rows, [stems[c.name] for c in coordinates])
        if all(c.name in stems for c in coordinates)
        else np.full((1, len(coordinates)), np.nan)
        for coordinates in (machine.command, machine.joints)
    ]
    if np.isnan(values[1]).all():
        try:
            values[1] = Kinematics(machine).inverse(values[0])[1]
        except AssemblyError:
            return model  # the check of the study says which pose is out of reach
    table = msgspec.structs.replace(
        model.table,
        workspace=_ranges(machine.command, values[0]) | model.table.workspace,
        travel=_ranges(machine.joints, values[1]) | model.table.travel,
    )
    return Model(machine, table)


def _ranges(
    coordinates: tuple[Coordinate, ...], values: Array
) -> dict[str, tuple[float, float]]:
    """Ranges, in their usual unit, of coordinates whose values (n, k) pass their own."""
    ranges = {}
    for c, column in zip(coordinates, values.T, strict=True):
        low, high = np.fmin.reduce(column), np.fmax.reduce(column)
        if low < c.lower or high > c.upper:
            margin = JOINT_MARGIN_SHARE * (high - low)
            key = usual_column(c.name, c.unit)
            ends = [min(low - margin, c.lower), max(high + margin, c.upper)]
            first, last = units.from_si(ends, key.rpartition("_")[2])
            ranges[key] = (round(float(first), 6), round(float(last), 6))
    return ranges


def _drop_zeros(model: Model) -> Model:
    """The machine without zeros and scales of its joints: no closure alone tells them."""
    names = {_stem(p.name) for p in model.machine.parameters}
    zeros = sorted(f"{stem}*" for stem in names - _sized_stems(model.machine))
    fixed = [*model.machine.frame, *zeros]
    return Model(model.machine, msgspec.structs.replace(model.table, fixed=fixed))


def _sized_stems(machine: Machine) -> set[str]:
    """Stems of parameters that are places or lengths, such as `anchor` of `anchor1x`."""
    return {_stem(p.name) for p in machine.parameters if p.unit == "m" and p.nominal}


def _stem(name: str) -> str:
    return name.rstrip("xyz").rstrip("0123456789")


def _prior(machine: Machine) -> tuple[str, str]:
    """The tables [[prior.tolerance]] of places and lengths, and a sentence on them."""
    size = max((abs(p.nominal) for p in machine.parameters if p.unit == "m"), default=0)
    sigma = float(f"{units.number(RELATIVE_TOLERANCE * size, 'mm'):.2g}")
    patterns = sorted(f"{stem}*" for stem in _sized_stems(machine))
    tables = {"prior": {"tolerance": [{"parameters": patterns, "sigma_mm": sigma}]}}
    names = ", ".join(patterns)
    return tomli_w.dumps(tables), f"Known before to {sigma:g} mm: {names}."


# What a user's own header says: `x`, `measured x (mm)`, `belt 2`, `tl`, `distance`.
#
# A name is a quantity with, at will, a unit and a word that says whether it was commanded or
# measured. Lengths without a unit are mm, angles degrees.

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
ENDS: Final = ("1", "2")  #: ends of a measured distance, as in x1, y1, x2, y2


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
