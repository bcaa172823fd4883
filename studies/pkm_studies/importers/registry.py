"""The importers by name: those of this package, and those of entry points."""

from __future__ import annotations

import importlib
import warnings
from importlib import metadata

from pkm_studies.base.errors import InputError, shorten, suggest
from pkm_studies.importers.base import Importer

#: group of entry points that add importers
GROUP = "pkm_oed.importers"
#: importers of this package: the module's name in this folder
SHIPPED = (
    "klipper",
    "rrf",
    "marlin",
    "maslow",
    "hangprinter",
    "tracker",
    "ballbar",
    "columns",
)


def importers() -> dict[str, Importer]:
    """Every importer by its name; a warning names those that cannot be loaded."""
    known = {name: _shipped(name) for name in SHIPPED}
    for name, entry in _installed().items():
        try:
            known[name] = _load(entry)
        except InputError as error:
            warnings.warn(str(error), stacklevel=2)
    return known


def importer(name: str) -> Importer:
    """The importer of this name; no other one is loaded. Raises InputError."""
    installed = _installed()
    if name in SHIPPED:
        return _shipped(name)
    if name in installed:
        return _load(installed[name])
    remedy = suggest(name, [*SHIPPED, *installed], "known")
    raise InputError("no such kind of file", remedy, field="KIND", value=name)


def _shipped(name: str) -> Importer:
    module = importlib.import_module(f"pkm_studies.importers.{name}")
    loaded: Importer = module.importer
    return loaded


def _installed() -> dict[str, metadata.EntryPoint]:
    """Entry points by name; those of this package's names are not used."""
    entries = metadata.entry_points(group=GROUP)
    return {entry.name: entry for entry in entries if entry.name not in SHIPPED}


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
