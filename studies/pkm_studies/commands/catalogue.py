"""Subcommands of the catalogue: list and schema."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Annotated

import typer

from pkm_studies import console
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


def list_entries(
    kind: Annotated[Kind, typer.Argument(show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> int:
    """List the catalogue: machines, instruments, effects, importers and others."""
    if kind is Kind.studies:
        return _list_studies(as_json)
    if kind is Kind.importers:
        return _list_importers(as_json)
    import dataclasses

    from pkm_studies.resolve import conventions_listing

    entries = conventions_listing(kind.value)
    if as_json:
        console.print_json([dataclasses.asdict(entry) for entry in entries])
        return DONE
    _print_rows([(e.name, _entry_lines(e)) for e in entries])
    return DONE


def _entry_lines(entry: CatalogueEntry) -> list[str]:
    """What it is, its source, its frames and its columns; parameters fill a page."""
    listed = [c for c in entry.columns if c["role"] != "parameter"]
    columns = [f"{c['name']}: {c['role']}: {c['about']}" for c in listed]
    return [entry.about, f"source: {entry.source}", *entry.frames, *columns]


def _list_studies(as_json: bool) -> int:
    from pkm_studies import shipped

    studies = list(shipped.studies().values())
    if as_json:
        entries = [
            {"name": s.name, "title": s.title, "question": s.question} for s in studies
        ]
        console.print_json(entries)
        return DONE
    _print_rows([(s.name, [s.title, s.question]) for s in studies])
    return DONE


def _list_importers(as_json: bool) -> int:
    from pkm_studies.importers import importers

    listed = [(name, one.about) for name, one in importers().items()]
    if as_json:
        console.print_json([{"name": name, "about": about} for name, about in listed])
        return DONE
    _print_rows([(name, [about]) for name, about in listed])
    return DONE


def _print_rows(rows: list[tuple[str, list[str]]]) -> None:
    """Print names in a column, with the lines about each next to it."""
    width = max((len(name) for name, _ in rows), default=0)
    for name, lines in rows:
        for label, line in zip([name, *[""] * len(lines)], lines, strict=False):
            print(f"{label:<{width}}  {line}")


class Schema(enum.StrEnum):
    """Files that `oed schema` describes."""

    study = enum.auto()
    result = enum.auto()
    readings = enum.auto()


def schema(
    of: Annotated[
        Schema, typer.Argument(metavar="study|result|readings", show_default=False)
    ],
) -> int:
    """Print a JSON schema, for editors and scripts."""
    from pkm_studies.study import SCHEMAS

    console.print_json(SCHEMAS[of.value]())
    return DONE
