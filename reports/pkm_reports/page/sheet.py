"""A page to take to the machine: set-ups, commands, joint values, and cells to fill in."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from oed.result import PlannedReading, SetupInfo, StageRecord, StudyResult
from oed.safe_files import write_own
from oed.text import shorten
from pkm_reports import text
from pkm_reports.blocks import Section
from pkm_reports.page import document
from pkm_reports.page.document import Content, footer
from pkm_reports.sections import adjustment_blocks


# The page for the fitter: what to adjust, with room to write.
def write_adjustment_page(result: StudyResult, folder: Path) -> Path:
    """Write `adjustment.pdf` into a folder; its path. Raises ValueError, OSError."""
    section = result.adjustment
    if section is None:
        raise ValueError("this result has no adjustments")
    content = Content(
        title=result.title or result.study,
        question="What to adjust, in which order, and what it brings",
        study=result.study,
        machine=result.machine.name,
        foot=document.footer(result),
        answer=[Section("adjust", "Adjust", adjustment_blocks(section))],
        chapters=[],
        appendix=[],
    )
    page = document.Document(content).pdf()
    return write_own(folder / "adjustment.pdf", page)


MAX_ROWS: Final = 120  #: rows on the sheet; all readings are in poses.csv
#: parts of a table side by side, and the columns that fit beside one another
MAX_PARTS: Final = 4
COLUMNS_ACROSS: Final = 20
MIN_PART: Final = 6  #: rows of a part from which a table is split
#: height of the tables of a page, and of a row: least and most, mm
PAGE_HEIGHT: Final = 240.0
MIN_ROW_HEIGHT: Final = 4.3
MAX_ROW_HEIGHT: Final = 7.0
STAGE_HEIGHT: Final = 8.0  #: height of the text above a stage and above a set-up, mm
SETUP_HEIGHT: Final = 10.0
MAX_RUN_CHARACTERS: Final = 12  # characters


def write_sheet(
    result: StudyResult, poses: Sequence[PlannedReading] | None, folder: Path
) -> Path:
    """Write `measurement_sheet.pdf` into a folder and return its path.

    `poses` are in working order; None stands for those of the result. The folder is
    created where it is missing. Raises ValueError where there are no poses, OSError
    where the folder cannot be written.
    """
    if poses is None:
        poses = result.design.poses if result.design is not None else []
    if not poses:
        raise ValueError(
            "a measurement sheet needs poses: the result holds none, and none were"
            " handed over"
        )
    encoded = msgspec.json.encode(build(result, poses))
    page = document.compile_typst("sheet.typ", {"sheet.json": encoded})
    folder.mkdir(parents=True, exist_ok=True)
    return write_own(folder / "measurement_sheet.pdf", page)


def build(result: StudyResult, poses: Sequence[PlannedReading]) -> dict[str, Any]:
    """The sheet as text: stages of tables, and the height of a row, mm."""
    settings = {setup.name: _settings(setup) for setup in result.setups}
    stages = []
    room = MAX_ROWS
    also = _covariates(result)
    for title, setups in _stages(result, poses):
        tables = []
        for name in setups:
            of_setup = [pose for pose in poses if pose.setup == name]
            shown = of_setup[: max(room, 0)]
            room -= len(shown)
            table = _table(name, settings, shown, len(of_setup), also)
            tables.append(table)
        stages.append({"title": title, "tables": tables})
    sheet: dict[str, Any] = document.cleaned_values(
        {
            "title": result.title or result.study or "Measurements",
            "machine": result.machine.name,
            "foot": footer(result),
            "stages": stages,
            "row": _row_height(stages),
        }
    )
    return sheet


def _stages(
    result: StudyResult, poses: Sequence[PlannedReading]
) -> Iterator[tuple[str, list[str]]]:
    """Title and set-ups of each stage; set-ups that no stage names come last."""
    listed: list[str] = []
    planned = [] if result.plan is None else result.plan.stages
    for k, stage in enumerate(planned, 1):
        setups = [name for name in stage.setups if name not in listed]
        listed += setups
        yield _stage_title(k, stage), setups
    others = dict.fromkeys(pose.setup for pose in poses if pose.setup not in listed)
    if others:
        yield "Readings", list(others)


def _stage_title(k: int, stage: StageRecord) -> str:
    title = f"Stage {k}: {stage.measurement}"
    if stage.begin_min is not None:
        begin, end = text.trimmed(stage.begin_min, 3), text.trimmed(stage.end_min, 3)
        title += f", {begin} to {end}{text.NO_BREAK}min"
    if stage.operator:
        title += f", {stage.operator}"
    return title


def _table(
    name: str,
    settings: Mapping[str, str],
    poses: Sequence[PlannedReading],
    count: int,
    covariates: Sequence[str],
) -> dict[str, Any]:
    """One set-up with the poses shown, out of `count`; cells for readings and covariates.

    writing  number of columns to write in, the last ones
    blocks   rows of parts that stand side by side
    lines    rows of the tallest part with its heading, 0 without rows
    more     where the rows are that the sheet leaves out
    """
    channels = list(dict.fromkeys(key for pose in poses for key in pose.reading))
    channels = channels or ["reading"]
    titles, cells = ["No."], [[str(k) for k in range(1, len(poses) + 1)]]
    runs = [pose.run for pose in poses]
    if len(set(runs)) > 1:
        titles.append("Run")
        cells.append([shorten(run, MAX_RUN_CHARACTERS) for run in runs])
    named = []
    for pose in poses:
        # joints that are to be recorded have cells to write in instead
        joints = {k: v for k, v in pose.joints.items() if k not in channels}
        named.append(pose.command | joints)
    columns = text.aligned_columns(named, most=3)
    titles += map(text.heading, columns)
    cells += columns.values()
    written = [*map(text.heading, channels), *covariates]
    titles += written
    empty = [""] * len(written)
    rows = [[*row, *empty] for row in zip(*cells, strict=True)]
    per_part = _rows_per_part(len(rows), len(titles) + len(channels))
    return {
        "setup": name,
        "settings": settings.get(name, ""),
        "titles": titles,
        "writing": len(written),
        "blocks": [rows[k : k + per_part] for k in range(0, len(rows), per_part)],
        "lines": per_part + 1 if rows else 0,
        "more": _more(count - len(poses), count),
    }


def _covariates(result: StudyResult) -> list[str]:
    """What to note beside each reading, so that a diagnosis can test more effects."""
    budget = None if result.prediction is None else result.prediction.budget
    hidden = [] if budget is None else [u.not_testable or "" for u in budget.unmodelled]
    wants_direction = any("direction" in reason for reason in hidden)
    return ["time", "direction"] if wants_direction else ["time"]


def _rows_per_part(rows: int, width: int) -> int:
    """Rows of each part of a table; a cell to write in counts as two columns."""
    parts = min(MAX_PARTS, COLUMNS_ACROSS // width, math.ceil(rows / MIN_PART))
    return max(1, math.ceil(rows / max(1, parts)))


def _more(omitted: int, count: int) -> str:
    """Where the rows are that the sheet leaves out."""
    if not count:
        return "Poses and readings: see poses.csv"
    if not omitted:
        return ""
    noun = "more reading" if omitted < count else "reading"
    return f"{text.count(omitted, noun)}: see poses.csv"


def _settings(setup: SetupInfo) -> str:
    """Instrument and settings in a line."""
    parts = [setup.instrument, text.named_quantities(setup.numbers)]
    return " · ".join(part for part in parts if part and part != text.MISSING)


def _row_height(stages: Sequence[dict[str, Any]]) -> float:
    """mm: as much room to write as fits on the page."""
    tables = [table for stage in stages for table in stage["tables"]]
    lines = sum(int(table["lines"]) for table in tables)
    headings = STAGE_HEIGHT * len(stages) + SETUP_HEIGHT * len(tables)
    height = (PAGE_HEIGHT - headings) / max(lines, 1)
    return round(min(MAX_ROW_HEIGHT, max(MIN_ROW_HEIGHT, height)), 2)
