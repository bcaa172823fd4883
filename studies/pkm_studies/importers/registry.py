"""The importers by name: those of this package, and those of entry points."""

from __future__ import annotations

import importlib
from importlib import metadata

from pkm_studies.errors import InputError, shorten, suggest
from pkm_studies.importers.base import Importer

#: group of entry points that add importers
GROUP = "pkm_oed.importers"
#: importers of this package: the module's name in this folder
SHIPPED = ("klipper", "rrf", "marlin", "tracker", "ballbar", "columns")


def importers() -> dict[str, Importer]:
    """Every importer by its name. Raises InputError where an entry point fails."""
    known: dict[str, Importer] = {}
    for name in SHIPPED:
        module = importlib.import_module(f"pkm_studies.importers.{name}")
        known[name] = module.importer
    for entry in metadata.entry_points(group=GROUP):
        if entry.name not in known:
            known[entry.name] = _load(entry)
    return known


def importer(name: str) -> Importer:
    """The importer of this name. Raises InputError."""
    known = importers()
    if name not in known:
        remedy = suggest(name, known, "known")
        raise InputError("no such kind of file", remedy, field="KIND", value=name)
    return known[name]


def _load(entry: metadata.EntryPoint) -> Importer:
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
