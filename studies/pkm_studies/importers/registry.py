"""The importers by name: entry points `pkm_oed.importers`, those of this project first."""

import warnings
from importlib.metadata import EntryPoint

from oed.text import shorten, suggest
from pkm_studies.base import InputError, Location
from pkm_studies.catalogue import lookup
from pkm_studies.importers.base import Importer
from pkm_studies.plugins import plugins
from pkm_studies.user_code import Consent, Origin, is_file

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
