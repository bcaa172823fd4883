"""The report as data: numbered blocks as plain mappings, and the rendered images. Both
writers start from it.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from pkm_reports import sections, style
from pkm_reports.blocks import Block, Code, Items, Picture, Section, Table
from pkm_reports.sections import summary

#: control characters that neither HTML nor typst can show
INVISIBLE: Final = {
    code: "\N{REPLACEMENT CHARACTER}"
    for code in (*range(9), 11, 12, *range(14, 32), 127)
}


@dataclasses.dataclass(frozen=True, slots=True)
class Document:
    """`data` holds text only (see `templates/`); `images` its pictures by name."""

    data: dict[str, Any]
    images: dict[str, style.Image]


@dataclasses.dataclass(frozen=True, slots=True)
class Counter:
    """Running numbers of figures and tables."""

    figures: Iterator[int] = dataclasses.field(
        default_factory=lambda: itertools.count(1)
    )
    tables: Iterator[int] = dataclasses.field(
        default_factory=lambda: itertools.count(1)
    )


def build(result: Mapping[str, Any]) -> Document:
    """All words, tables and pictures of a result."""
    counter, images = Counter(), dict[str, style.Image]()
    with style.applied():
        head = _blocks(summary.blocks(result), counter, images)
        chapters = [
            _section(k, s, counter, images)
            for k, s in enumerate(sections.chapters(result), 1)
        ]
    data = {
        "title": _clean(result.get("title") or result["study"]),
        "question": _clean(result.get("question") or ""),
        "study": _clean(result["study"]),
        "machine": _clean(result["machine"]["name"]),
        "foot": _clean(
            f"{result['study']} · seed {result['seed']} · pkm-oed {result['version']}"
        ),
        "summary": head,
        "sections": chapters,
    }
    return Document(data, images)


def _section(
    number: int, section: Section, counter: Counter, images: dict[str, style.Image]
) -> dict[str, Any]:
    blocks = _blocks(section.blocks, counter, images)
    return {
        "number": number,
        "anchor": section.anchor,
        "title": section.title,
        "blocks": blocks,
    }


def _blocks(
    blocks: Sequence[Block], counter: Counter, images: dict[str, style.Image]
) -> list[dict[str, Any]]:
    return [{"kind": block.kind, **_told(block, counter, images)} for block in blocks]


def _told(
    block: Block, counter: Counter, images: dict[str, style.Image]
) -> dict[str, Any]:
    """The entries of one block; pictures are drawn here."""
    if isinstance(block, Table):
        return _table(block, next(counter.tables))
    if isinstance(block, Picture):
        images[block.name] = style.render(block.draw())
        return {
            "label": f"Figure {next(counter.figures)}",
            "caption": _clean(block.caption),
            "name": block.name,
            "file": f"{block.name}.svg",
            "width": float(images[block.name].width),
            "height": float(images[block.name].height),
        }
    if isinstance(block, Items):
        return {
            "items": [_clean(item) for item in block.items],
            "numbered": block.numbered,
        }
    if isinstance(block, Code):
        return {"text": _clean(block.text).rstrip("\n")}
    return {"text": _clean(block.text)}


def _table(table: Table, number: int) -> dict[str, Any]:
    columns = [
        {"title": _clean(c.title), "number": c.number, "wide": c.wide}
        for c in table.columns
    ]
    rows = [
        {"mark": table.mark(k), "cells": [_clean(cell) for cell in row]}
        for k, row in enumerate(table.rows)
    ]
    return {
        "label": f"Table {number}",
        "caption": _clean(table.caption),
        "columns": columns,
        "rows": rows,
    }


def _clean(text: Any) -> str:
    """Text without control characters and lone surrogates."""
    return (
        str(text)
        .translate(INVISIBLE)
        .encode("utf-8", "replace")
        .decode("utf-8")
        .replace("\r\n", "\n")
    )
