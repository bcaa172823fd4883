"""Column maps: a small TOML file that says which column of a CSV is what.

machine = "linear_delta"
instrument = "pose_tracker_position"

[columns]  # column of the readings, with the unit of the numbers = column of the CSV
x_mm = "X set"
read_x_mm = "X"
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import tomli_w

from oed.instrument import Instrument
from oed.model import Machine
from pkm_studies import catalogue, files, user_code
from pkm_studies import study as studies
from pkm_studies.base import Location
from pkm_studies.drafts import prediction_table
from pkm_studies.importers import column_sources
from pkm_studies.importers.base import ImportRequest, readings_name
from pkm_studies.importers.map_tables import ColumnMap
from pkm_studies.resolve import described_machine, study_machine
from pkm_studies.study import decode_table, tables_of
from pkm_studies.tables import MachineTable, PredictionReference
from pkm_studies.user_code import Consent, Origin

MAX_BYTES = 200_000


class Model(NamedTuple):
    """A machine with the table [machine] of a study in the out folder."""

    machine: Machine
    table: MachineTable

    @classmethod
    def from_table(cls, table: MachineTable, consent: Consent) -> "Model":
        """The machine of a table that names no file of the user's. Raises InputError."""
        origin = Origin.command(consent)
        return cls(described_machine(table, origin, Location("")), table)

    @property
    def described(self) -> str | MachineTable:
        """The table, or the model's name alone where the table has nothing else."""
        plain = MachineTable(model=self.table.model)
        return plain.model if plain == self.table else self.table


def load(request: ImportRequest) -> tuple[ColumnMap, Location]:
    """The user's map, or an empty one. Raises InputError."""
    if request.map is None:
        return ColumnMap(), Location("--map")
    location = Location(str(request.map))
    text = files.read_text(request.map, limit=MAX_BYTES, what="column map")
    table = tables_of(text, location)
    return column_sources.expanded(
        decode_table(ColumnMap, table, location), location
    ), location


def model(request: ImportRequest, column_map: ColumnMap, location: Location) -> Model:
    """The machine of --machine (model, file or study), or of the map. Raises InputError."""
    if isinstance(request.machine, str) and request.machine.endswith(".toml"):
        study = studies.Study.load(request.machine, request.consent)
        machine = study_machine(study)
        return _model(machine, study.machine, study.folder, request)
    described: str | MachineTable | None = request.machine
    origin, field = Origin.command(request.consent), Location("--machine")
    if described is None:
        described = column_map.machine
        field = location.key("machine")
        origin = _map_origin(request)
    if described is None:
        raise field.error("missing", "give --machine, or machine in the map")
    if isinstance(described, str):
        machine = catalogue.machine(described, origin, field)
        described = MachineTable(model=described)
    else:
        machine = described_machine(described, origin, field)
    return _model(machine, described, origin.folder, request)


def instrument(
    request: ImportRequest,
    column_map: ColumnMap,
    location: Location,
    machine: Machine,
    default: str | None = None,
) -> tuple[Instrument, str]:
    """The instrument of the map, or a default, on the machine. Raises InputError."""
    reference = column_map.instrument or default
    field = location.key("instrument")
    if reference is None:
        raise field.error(
            "missing", "name one of `oed list instruments` in a --map file"
        )
    origin = _map_origin(request)
    loaded = catalogue.instrument(reference, origin, field)
    reason = loaded.for_machine(machine).unfit(machine)
    if reason is not None:
        problem = f"it cannot read {machine.name}: {reason}"
        raise field.error(problem, "take another of `oed list instruments`", reference)
    return loaded.for_machine(machine), _relative_reference(
        reference, origin.folder, request
    )


def text(column_map: ColumnMap) -> str:
    """The map as a file, without fields at their defaults."""
    plain: dict[str, Any] = msgspec.to_builtins(column_map)
    defaults = msgspec.to_builtins(ColumnMap())
    table = {key: value for key, value in plain.items() if value != defaults[key]}
    if column_map.columns:
        table["columns"] = {
            name: entry
            if isinstance(entry, str)
            else _given(msgspec.to_builtins(entry))
            for name, entry in column_map.columns.items()
        }
    if isinstance(column_map.machine, MachineTable):
        table["machine"] = _stated(column_map.machine)
    for name in ("circle", "orientation"):
        if plain[name] is not None:
            table[name] = _given(plain[name])
    if column_map.circles:
        table["circles"] = [_given(circle) for circle in plain["circles"]]
    return "# Which column is what; use it again with --map.\n" + tomli_w.dumps(table)


def _given(table: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in table.items() if v is not None and v != []}


def imported_study(
    request: ImportRequest,
    model: Model,
    title: str,
    setups: Sequence[Mapping[str, object]],
    noise: Mapping[str, object],
    errors: PredictionReference = "home",
) -> str:
    """The study of set-ups with readings; `errors`: what predicted ones refer to."""
    tables = {
        "schema": 1,
        "name": request.name,
        "title": title,
        "machine": _stated(model.table),
        "setup": list(setups),
        "noise": {**noise, "estimate": True},
        "readings": {"files": [readings_name(request.name)]},
    }
    comment = f"Imported from {', '.join(path.name for path in request.files)}."
    head = f"# {comment}\n# `oed run` runs it; see `oed schema study`."
    prediction = prediction_table(model.machine, errors)
    return f"{head}\n\n{tomli_w.dumps(tables)}\n{prediction}"


def _map_origin(request: ImportRequest) -> Origin:
    """Where the models that a map names are looked for."""
    folder = request.map.parent if request.map is not None else Path()
    return Origin(folder, request.consent)


def _model(
    machine: Machine, table: MachineTable, folder: Path, request: ImportRequest
) -> Model:
    """The model whose table names its file as the out folder sees it."""
    reference = _relative_reference(table.model, folder, request)
    return Model(machine, msgspec.structs.replace(table, model=reference))


def _stated(table: MachineTable) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(table)
    defaults = msgspec.to_builtins(MachineTable(model=""))
    return {key: value for key, value in plain.items() if value != defaults[key]}


def _relative_reference(reference: str, folder: Path, request: ImportRequest) -> str:
    """A reference as the out folder sees it; a file from outside is to be copied."""
    if not user_code.is_file(reference):
        return reference
    name = user_code.file_name(reference)
    attribute = reference[len(name) :]
    path, out = (folder / name).resolve(), request.folder.resolve()
    if path.is_relative_to(out):
        return path.relative_to(out).as_posix() + attribute
    request.copies[path.name] = path
    return path.name + attribute
