"""A page to take to the machine: stage by stage the set-up, its settings, and cells for
what is read.

Poses are those of result.json (`design.poses`), or rows handed over in the same shape:
mappings with `setup`, `run`, `order`, `command` {coordinate with unit: number} and,
where known, `reading` {channel with unit: nominal number}.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

import typst

from pkm_reports import words
from pkm_reports.document import INVISIBLE

#: rows on the sheet; the rest is in poses.csv
MOST: Final = 120
#: blocks of a table side by side, and the columns that fit beside one another
BLOCKS: Final = 4
ACROSS: Final = 20
#: height of the tables of a page, and of a row: least and most, mm
PAGE: Final = 240.0
LEAST: Final = 4.3
ROOM: Final = 7.0
#: height of the words above a stage and above a set-up, mm
HEAD: Final = 8.0
SETTING: Final = 10.0
Part = Mapping[str, Any]


def write_sheet(result: Part, poses: Sequence[Part] | None, folder: Path) -> Path:
    """Writes `measurement_sheet.pdf` into the folder (made if it is not there) and
    returns its path.

    `result` is the mapping decoded from result.json; `poses` in working order, None for
    those of the result. Raises ValueError where there are no poses, OSError where the
    folder cannot be written.
    """
    rows = list(
        ((result.get("design") or {}).get("poses") or []) if poses is None else poses
    )
    if not rows:
        raise ValueError(
            "a measurement sheet needs poses: the result holds none, and none were"
            " handed over"
        )
    template = (
        resources.files("pkm_reports").joinpath("templates", "sheet.typ").read_bytes()
    )
    told = json.dumps(_clean(sheet(result, rows)), ensure_ascii=False).encode("utf-8")
    compiler: Any = (
        typst.compile
    )  # its stubs do not know that several files can be given as bytes
    pages = compiler(
        {"main.typ": template, "sheet.json": told}, format="pdf", timestamp=0
    )
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "measurement_sheet.pdf"
    path.write_bytes(pages)
    return path


def sheet(result: Part, poses: Sequence[Part]) -> dict[str, Any]:
    """The sheet as text: stages of tables, each in blocks that stand side by side."""
    settings = {str(s["name"]): s for s in result.get("setups") or []}
    stages, room = [], MOST
    for title, setups in _stages(result, poses):
        tables = []
        for name in setups:
            mine = [p for p in poses if str(p["setup"]) == name]
            shown = mine[: max(room, 0)]
            room -= len(shown)
            tables.append(_table(name, settings.get(name), shown, len(mine)))
        stages.append({"title": title, "tables": tables})
    return {
        "title": str(result.get("title") or result.get("study") or "Measurements"),
        "machine": str((result.get("machine") or {}).get("name") or ""),
        "foot": (
            f"{result.get('study', '')} · seed {result.get('seed', '')} · pkm-oed"
            f" {result.get('version', '')}"
        ),
        "stages": stages,
        "row": _row_height(stages),
    }


def _stages(result: Part, poses: Sequence[Part]) -> Iterator[tuple[str, list[str]]]:
    """Title and set-ups of each stage; set-ups that no stage names come last."""
    told: list[str] = []
    for k, stage in enumerate((result.get("plan") or {}).get("stages") or [], 1):
        mine = [
            str(name) for name in stage.get("setups") or [] if str(name) not in told
        ]
        told += mine
        title = f"Stage {k}: {stage['measurement']}"
        if stage.get("begin_min") is not None:
            title += (
                f", {words.plain(stage['begin_min'], 3)} to"
                f" {words.plain(stage.get('end_min'), 3)}{words.GAP}min"
            )
        title += f", {stage['operator']}" if stage.get("operator") else ""
        yield title, mine
    left = [
        name
        for name in dict.fromkeys(str(p["setup"]) for p in poses)
        if name not in told
    ]
    if left:
        yield "Readings", left


def _table(
    name: str, setting: Part | None, poses: Sequence[Part], count: int
) -> dict[str, Any]:
    """One set-up: what to set, and its rows in blocks; `more` says how many rows are
    left out.
    """
    commands = list(dict.fromkeys(key for p in poses for key in p.get("command") or {}))
    readings = list(
        dict.fromkeys(key for p in poses for key in p.get("reading") or {})
    ) or ["reading"]
    runs = len({str(p.get("run")) for p in poses}) > 1
    cells = [[str(k) for k in range(1, len(poses) + 1)]]
    cells += [[words.cut(str(p.get("run", "")), 12) for p in poses]] if runs else []
    cells += [
        words.column([(p.get("command") or {}).get(c) for p in poses], most=3)
        for c in commands
    ]
    rows = [list(row) + [""] * len(readings) for row in zip(*cells, strict=True)]
    titles = [
        "No.",
        *(["Run"] if runs else []),
        *[words.heading(k) for k in (*commands, *readings)],
    ]
    # A cell to write in takes the room of two numbers.
    blocks = max(
        1,
        min(BLOCKS, ACROSS // (len(titles) + len(readings)), math.ceil(len(rows) / 6)),
    )
    each = max(1, math.ceil(len(rows) / blocks))
    return {
        "setup": name,
        "settings": _settings(setting),
        "titles": titles,
        "writing": len(readings),
        "blocks": [rows[k : k + each] for k in range(0, len(rows), each)],
        "lines": each + 1 if rows else 0,
        "more": _more(count - len(poses), count),
    }


def _more(left: int, count: int) -> str:
    """Where the rows are that the sheet leaves out."""
    if not count:
        return "Poses and readings: see poses.csv"
    return (
        f"{words.count(left, 'more reading' if left < count else 'reading')}: see"
        " poses.csv"
        if left
        else ""
    )


def _settings(setting: Part | None) -> str:
    """Instrument and settings in a line."""
    if setting is None:
        return ""
    numbers = words.numbers(setting.get("numbers") or {})
    return " · ".join(
        text
        for text in (str(setting.get("instrument", "")), numbers)
        if text and text != words.MISSING
    )


def _row_height(stages: Sequence[Part]) -> float:
    """mm: as much room to write as fits on the page."""
    tables = [table for stage in stages for table in stage["tables"]]
    lines = sum(int(table["lines"]) for table in tables)
    words_above = HEAD * len(stages) + SETTING * len(tables)
    return round(min(ROOM, max(LEAST, (PAGE - words_above) / max(lines, 1))), 2)


def _clean(told: Any) -> Any:
    """The same without control characters and lone surrogates."""
    if isinstance(told, dict):
        return {key: _clean(value) for key, value in told.items()}
    if isinstance(told, list):
        return [_clean(value) for value in told]
    return (
        told.translate(INVISIBLE).encode("utf-8", "replace").decode("utf-8")
        if isinstance(told, str)
        else told
    )
