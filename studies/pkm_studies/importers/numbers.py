"""A user's own numbers: a CSV whose header says what its columns are, and a machine's name.

The instrument follows from what was measured. The machine's numbers are taken for as good
as a tape measure finds them, and the noise for an assumption that the readings replace.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import msgspec
import numpy as np
import tomli_w

from oed import units
from oed.base import Array
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Coordinate, Machine
from pkm_studies import catalogue
from pkm_studies.base import InputError, Location
from pkm_studies.csv_table import CsvTable
from pkm_studies.importers import column_map, columns, nominal_poses, plain_header
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row
from pkm_studies.importers.column_map import Model
from pkm_studies.importers.line_times import read_tables
from pkm_studies.importers.map_tables import ColumnMap
from pkm_studies.quantities import column as usual_column
from pkm_studies.tables import PredictionReference
from pkm_studies.user_code import Origin

#: share of the machine's size to which a user knows its places and lengths: some cm of 3 m
RELATIVE_TOLERANCE: Final = 0.01
#: mm; lengths and places by a tape measure, heights by a probe
TAPE_MM: Final = 0.5
PROBE_MM: Final = 0.1
#: share of a range by which joints may pass what the readings need
MARGIN: Final = 0.1


class MeasuredKind(NamedTuple):
    """What was measured: the instrument, its noise, and what errors refer to."""

    instrument: str
    noise: dict[str, float]
    errors: PredictionReference


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
        stems = plain_header.quantities(table, model.machine)
        table, stems = _ends_as_rows(table, stems)
        measured = _measured_kind(set(stems.values()), model.machine, table)
        origin = Origin.command(request.consent)
        tool = catalogue.instrument(measured.instrument, origin, location)
        tool = tool.for_machine(model.machine)
        mapping = ColumnMap(columns={stem: name for name, stem in stems.items()})
        if measured.instrument == "contact_probe":
            mapping.columns["z_mm"] = mapping.columns.pop("height_mm")
        mapped = columns.mapped_columns(mapping, table, model.machine, tool, location)
        rows = columns.rows(table, mapped, mapping, tool, location)
        model = _widened(model, rows)
        if tool.implied is not None:
            model = _without_zeros(model)
        setup = columns.setup_table(
            msgspec.structs.replace(mapping, columns=mapped), measured.instrument, tool
        )
        title = f"{model.machine.name} read by {tool.name}"
        noise = {"assumed": True, **measured.noise}
        prior, known = _prior(model.machine)
        study = column_map.imported_study(
            request, model, title, [setup], noise, measured.errors
        )
        return ImportedSession(
            study=f"{study}\n{prior}",
            rows=rows,
            statements=[
                *columns.statements(table, mapped, mapping, tool, model.machine),
                f"Instrument: {measured.instrument}, noise assumed.",
                known,
            ],
        )


importer = NumbersImporter()


def _measured_kind(stems: set[str], machine: Machine, table: CsvTable) -> MeasuredKind:
    """What was measured, from columns of the readings. Raises InputError."""
    names = {stem.rpartition("_")[0] for stem in stems}
    axes = [axis for axis in "xyz" if f"read_{axis}" in names]
    if axes:
        is_planar = axes == ["x", "y"] and "z" not in {c.name for c in machine.pose}
        noise = {f"read_{axis}_mm": TAPE_MM for axis in axes}
        kind = "planar_position" if is_planar else "camera"
        return MeasuredKind(kind, noise, "best_fit")
    if "length" in names:
        return MeasuredKind("calliper", {"length_mm": TAPE_MM}, "best_fit")
    if "height" in names:
        kind = "height_probe" if "z" in names else "contact_probe"
        return MeasuredKind(kind, {"height_mm": PROBE_MM}, "home")
    redundancy = len(machine.joints) - len(machine.command)
    if redundancy > 0 and {joint.name for joint in machine.joints} <= names:
        gaps = (
            ["gap"] if redundancy == 1 else [f"gap{k + 1}" for k in range(redundancy)]
        )
        return MeasuredKind(
            "redundancy", {f"{gap}_mm": TAPE_MM for gap in gaps}, "best_fit"
        )
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
    """Each measured distance as a run of two rows, its ends; other tables as they are.

    Raises InputError for distances without ends.
    """
    ends = [
        {s.replace(f"{end}_", "_"): name for name, s in stems.items() if f"{end}_" in s}
        for end in plain_header.ENDS
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
            place = [cells[index[end[stem]]] for stem in ends[0]]
            lines.append((number, [str(run), *place, length]))
    return CsvTable(table.file, header, tuple(lines)), {n: n for n in header[1:]}


def _widened(model: Model, rows: list[Row]) -> Model:
    """The machine with workspace and travel that hold the readings too."""
    machine = model.machine
    command = _values(rows, machine.command)
    joints = _values(rows, machine.joints)
    if command is not None and joints is None:
        try:
            _, joints = Kinematics(machine).inverse(command)
        except AssemblyError:
            return model  # the check of the study says which pose is out of reach
    table = msgspec.structs.replace(
        model.table,
        workspace=_ranges(machine.command, command) | model.table.workspace,
        travel=_ranges(machine.joints, joints) | model.table.travel,
    )
    return Model(machine, table)


def _values(rows: list[Row], coordinates: tuple[Coordinate, ...]) -> Array | None:
    """Values (n, k) of coordinates, SI; None where a column is missing."""
    stems = {name.rpartition("_")[0]: name for name in rows[0]}
    names = [stems.get(c.name, "") for c in coordinates]
    return nominal_poses.si_numbers(rows, names) if all(names) else None


def _ranges(
    coordinates: tuple[Coordinate, ...], values: Array | None
) -> dict[str, tuple[float, float]]:
    """Ranges, in their usual unit, of coordinates whose values (n, k) pass their own."""
    ranges = {}
    for k, c in enumerate(coordinates):
        if values is None or np.isnan(values[:, k]).all():
            continue
        low, high = float(np.nanmin(values[:, k])), float(np.nanmax(values[:, k]))
        if low >= c.lower and high <= c.upper:
            continue
        margin = MARGIN * (high - low)
        key = usual_column(c.name, c.unit)
        ends = min(low - margin, c.lower), max(high + margin, c.upper)
        first, last = (units.number(v, key.rpartition("_")[2]) for v in ends)
        ranges[key] = (round(first, 6), round(last, 6))
    return ranges


def _without_zeros(model: Model) -> Model:
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
