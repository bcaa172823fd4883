"""What an importer is: it turns files of another program into a study with readings."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

from oed import csv_text
from oed.dataset import commented
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent

Row = Mapping[str, str]  #: cells of a row of the readings file, by column
MeshUse = Literal["hold-out", "readings"]  #: what the heights of bed meshes are for


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
    """Reads the files of one kind. An entry point of `pkm_oed.importers` adds more."""

    name: str  #: as in `oed import NAME`
    about: str  #: what it reads, for the list

    def read(self, request: ImportRequest) -> ImportedSession:
        """The session in the files. Raises InputError with file, line and remedy."""
        ...


def unused_options(importer: Importer) -> tuple[str, ...]:
    """Options of `oed import` that the importer states that it does not read."""
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
