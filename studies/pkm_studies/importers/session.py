"""Finds and runs an importer, and writes the study with its readings into a folder."""

import re
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path

from oed.instrument import Instrument
from oed.mechanism import AssemblyError
from oed.text import shorten, suggest
from pkm_studies import catalogue, files
from pkm_studies.base import InputError, Location
from pkm_studies.catalogue import lookup
from pkm_studies.importers import base
from pkm_studies.importers.base import ImportedSession, Importer, ImportRequest, MeshUse
from pkm_studies.plugins import plugins
from pkm_studies.resolve import readings_comments, resolve, study_machine
from pkm_studies.study import SUFFIX, Study
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent, Origin, is_file


def import_files(
    kind: str,
    paths: Sequence[Path],
    out: Path,
    *,
    name: str | None = None,
    machine: str | MachineTable | None = None,
    column_map: Path | None = None,
    mesh: MeshUse = "hold-out",
    consent: Consent = Consent.RECORDED,
) -> tuple[Path, ImportedSession]:
    """Write study and readings; study's path, session. Raises InputError for old files."""
    importer = named_importer(kind, consent)
    stated = {"--machine": machine is not None, "--map": column_map is not None}
    stated["--mesh"] = mesh != "hold-out"
    for option in base.unused_options(importer):
        if stated[option]:
            problem = f"files of the kind {kind} need no {option}"
            raise InputError(problem, "leave it out", field=option)
    files.check_writable(out)
    title = study_name(name or paths[0].name.split(".")[0])
    request = ImportRequest(
        files=tuple(paths),
        name=title,
        machine=machine,
        map=column_map,
        folder=out,
        consent=consent,
        mesh=mesh,
    )
    targets = [out / f"{title}{SUFFIX}", out / base.readings_name(title)]
    for path in targets:
        _check_new(path)
    session = importer.read(request)
    contents: list[str | bytes] = [
        session.study,
        _readings(session, targets[0], consent),
    ]
    map_path = out / f"{title}.map.toml"
    if session.column_map is not None and not map_path.exists():
        targets.append(map_path)
        contents.append(session.column_map)
    for name, source in request.copies.items():
        code = source.read_bytes()
        if _is_missing(out / name, code):
            targets.append(out / name)
            contents.append(code)
    # the study last: whoever finds it finds what it names
    files.write_all(dict(reversed([*zip(targets, contents, strict=True)])))
    try:
        resolve(Study.load(targets[0], consent), readings=()).with_stated_readings()
    except (InputError, AssemblyError) as error:
        for path in targets:
            path.unlink()
        blamed = ", ".join(map(str, paths))
        if is_file(kind):
            blamed += f", as {kind} reads it"
        if isinstance(error, InputError) and error.file not in map(str, targets):
            blamed = error.file or blamed
        raise _no_study(error, blamed, has_map=map_path in targets) from error
    return targets[0], session


def _no_study(
    error: InputError | AssemblyError, file: str, *, has_map: bool
) -> InputError:
    """The error about files whose study no other command would take."""
    if isinstance(error, AssemblyError):
        return InputError(str(error), "check the machine's numbers", file=file)
    remedy = error.remedy
    if has_map and error.field.startswith("row"):
        remedy += "; a machine that goes further has workspace and travel in [machine] of a map"
    return InputError(
        error.problem, remedy, file=file, field=error.field, value=error.value
    )


def _readings(session: ImportedSession, path: Path, consent: Consent) -> str:
    """The readings file, with what its columns mean where the study resolves."""
    try:
        study = Study.parse(session.study, path, consent)
        comments = comments_of_study(study)
    except InputError:
        return base.readings_text(session.rows)
    return base.readings_text(session.rows, comments)


def comments_of_study(study: Study) -> Callable[[Sequence[str]], Sequence[str]]:
    """`readings_comments` of a study, over the names of the columns. Raises InputError."""
    machine = study_machine(study)
    setups = {}
    for i, table in enumerate(study.setup):
        field = study.location.path("setup", i, "instrument")
        listed: Instrument = catalogue.instrument(table.instrument, study.origin, field)
        setups[table.name] = listed.for_machine(machine)
    return lambda header: readings_comments(machine, setups, header)


def study_name(text: str) -> str:
    """A name for a study from a file's name, such as `printer` from `printer.cfg`."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", text).strip("_-")
    return name or "imported"


def _is_missing(path: Path, content: bytes) -> bool:
    """Whether a file is to be written. Raises InputError where another is there."""
    if path.is_file() and path.read_bytes() == content:
        return False
    _check_new(path)
    return True


def _check_new(path: Path) -> None:
    if path.exists():
        raise InputError(
            "this file exists, and importing overwrites nothing",
            "take another --out or --name, or remove it",
            file=str(path),
        )


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


def named_importer(name: str, consent: Consent) -> Importer:
    """The importer of this name, or in a user's file. Raises InputError."""
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
