"""What an importer is: it turns files of another program into a study with readings."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

from oed import csv_text
from oed.dataset import commented
from oed.text import shorten, suggest
from pkm_studies.base import InputError, Location
from pkm_studies.catalogue import lookup
from pkm_studies.plugins import plugins
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent, Origin, is_file

#: cells of a row of the readings file, by column
Row = Mapping[str, str]
#: what the heights of bed meshes are for
MeshUse = Literal["hold-out", "readings"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImportRequest:
    """What `oed import` was asked for.

    files    the files to read, at least one
    name     of the study
    machine  the model that the user names, or its table [machine], if any
    map      the user's column map, a TOML file, if any
    folder   where the study goes: paths in the study are relative to it
    consent  to run Python files that the user, or his map, names
    copies   Python files that the study names, to copy into the folder, by name there
    mesh     whether the heights of bed meshes are held out of the fit, or readings of it
    """

    files: tuple[Path, ...]
    name: str
    machine: str | MachineTable | None = None
    map: Path | None = None
    folder: Path = Path()
    consent: Consent = Consent.RECORDED
    copies: dict[str, Path] = dataclasses.field(default_factory=dict)
    mesh: MeshUse = "hold-out"


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImportedSession:
    """A session as read.

    study       text of NAME.study.toml
    rows        rows of NAME.readings.csv
    statements  what was taken for what, one sentence each
    column_map  text of NAME.map.toml, where there is one to use again
    """

    study: str
    rows: Sequence[Row]
    statements: Sequence[str]
    column_map: str | None = None


@runtime_checkable
class Importer(Protocol):
    """Reads the files of one kind. An entry point of `pkm_oed.importers` adds more.

    name   as in `oed import NAME`
    about  what it reads, for the list
    """

    name: str
    about: str

    def read(self, request: ImportRequest) -> ImportedSession:
        """The session in the files. Raises InputError with file, line and remedy."""
        ...


def unused_options(importer: Importer) -> tuple[str, ...]:
    """Options of `oed import` that the importer does not read.

    It states them as `unused`; one of another package may state none.
    """
    return getattr(importer, "unused", ())


def readings_name(name: str) -> str:
    """Name of the readings file that goes with the study `name`."""
    return f"{name}.readings.csv"


def readings_text(
    rows: Sequence[Row],
    comments: Callable[[Sequence[str]], Sequence[str]] = lambda header: (),
) -> str:
    """The text of a readings file; cells that a row does not have are empty.

    comments  lines above the header, from the names of the columns
    """
    header = dict.fromkeys(column for row in rows for column in row)
    names = list(header)
    return commented(comments(names)) + csv_text.of_tables(names, rows)


def line_field(number: int, field: str = "") -> str:
    """The place in a file as an error shows it: `line 12, radius`."""
    return f"line {number}, {field}" if field else f"line {number}"


# The importers by name: entry points `pkm_oed.importers`, those of this project first.


KIND = "importers"


def importers() -> dict[str, Importer]:
    """Every importer by its name; a warning names those that cannot be loaded."""
    by_name: dict[str, Importer] = {}
    for entry in plugins(KIND):
        if entry.name in by_name:
            continue
        try:
            by_name[entry.name] = _load(entry)
        except InputError as error:
            warnings.warn(str(error), stacklevel=2)
    return by_name


def importer(name: str, consent: Consent) -> Importer:
    """The importer of this name, or in a user's file; no other one is loaded.

    Raises InputError.
    """
    if is_file(name):
        origin = Origin.command(consent)
        user_importer: Importer = lookup(name, KIND, Importer, origin, Location("KIND"))
        return user_importer
    entries = plugins(KIND)
    entry = next((entry for entry in entries if entry.name == name), None)
    if entry is None:
        remedy = suggest(name, [entry.name for entry in entries], "known")
        remedy += ", or a file of your own: path/to/file.py"
        raise InputError("no such kind of file", remedy, field="KIND", value=name)
    return _load(entry)


def _load(entry: EntryPoint) -> Importer:
    try:
        loaded = entry.load()
    except Exception as error:
        raise InputError(
            f"loading it failed with {type(error).__name__}: {shorten(str(error), 80)}",
            "mend or uninstall the package that provides it",
            field=f"importer {entry.name}",
            value=entry.value,
        ) from error
    if not isinstance(loaded, Importer):
        raise InputError(
            "it is no importer",
            "give it name, about and read(request)",
            field=f"importer {entry.name}",
            value=entry.value,
        )
    return loaded
