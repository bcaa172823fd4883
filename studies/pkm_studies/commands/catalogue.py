"""Subcommands of the catalogue: list and schema."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from oed.text import suggest
from pkm_studies import console
from pkm_studies.base import InputError
from pkm_studies.console import DONE

if TYPE_CHECKING:
    from pkm_studies.catalogue import CatalogueEntry


class Kind(enum.StrEnum):
    """What `oed list` lists."""

    machines = enum.auto()
    instruments = enum.auto()
    effects = enum.auto()
    criteria = enum.auto()
    formats = enum.auto()
    importers = enum.auto()
    studies = enum.auto()


class ListedEntry(NamedTuple):
    """An entry of the catalogue: its name, the lines about it, and all of it for JSON."""

    name: str
    lines: list[str]
    record: dict[str, Any]


def list_entries(
    kind: Annotated[Kind, typer.Argument(show_default=False)],
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="All about one of them, with its source."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> int:
    """List machines, instruments, effects, importers and others, or all about one."""
    entries = _entries(kind)
    if name is not None:
        names = [entry.name for entry in entries]
        if name not in names:
            problem = f"{name} is none of the {kind.value}"
            raise InputError(problem, suggest(name, names), field="NAME")
        entries = [entry for entry in entries if entry.name == name]
    if as_json:
        console.print_json([entry.record for entry in entries])
        return DONE
    width = max((len(entry.name) for entry in entries), default=0)
    for entry in entries:
        lines = entry.lines if name is not None else entry.lines[:1]
        for label, line in zip([entry.name, *[""] * len(lines)], lines, strict=False):
            print(f"{label:<{width}}  {line}")
    return DONE


def _entries(kind: Kind) -> list[ListedEntry]:
    if kind is Kind.studies:
        from pkm_studies import shipped

        return [
            ListedEntry(
                s.name,
                [s.title, s.question],
                {"name": s.name, "title": s.title, "question": s.question},
            )
            for s in shipped.studies().values()
        ]
    if kind is Kind.importers:
        from pkm_studies.importers import importers

        return [
            ListedEntry(name, [one.about], {"name": name, "about": one.about})
            for name, one in importers().items()
        ]
    import dataclasses

    from pkm_studies.resolve import conventions_listing

    return [
        ListedEntry(entry.name, _entry_lines(entry), dataclasses.asdict(entry))
        for entry in conventions_listing(kind.value)
    ]


def _entry_lines(entry: CatalogueEntry) -> list[str]:
    """What it is, its source, its frames and its columns; parameters fill a page."""
    listed = [c for c in entry.columns if c["role"] != "parameter"]
    columns = [f"{c['name']}: {c['role']}: {c['about']}" for c in listed]
    return [entry.about, f"source: {entry.source}", *entry.frames, *columns]


class Schema(enum.StrEnum):
    """Files that `oed schema` describes."""

    study = enum.auto()
    result = enum.auto()
    readings = enum.auto()


def schema(
    of: Annotated[Schema, typer.Argument(metavar="study|result|readings")],
) -> int:
    """Print a JSON schema, for editors and scripts."""
    from pkm_studies.study import SCHEMAS

    console.print_json(SCHEMAS[of.value]())
    return DONE
