"""The plans of several results: where their readings lie, and how they score."""

from __future__ import annotations

from collections.abc import Mapping

from oed.result import DesignSection, Drawing, StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Picture, Table, TableColumn, number_columns
from pkm_reports.sections import draw_overview


def blocks(results: Mapping[str, StudyResult]) -> list[Block]:
    """A picture of each plan, and a table of their scores."""
    content: list[Block] = []
    drawings = {n: r.drawing for n, r in results.items() if r.drawing is not None}
    for k, (name, drawing) in enumerate(drawings.items()):
        if drawing.lines and drawing.tool_points:
            content.append(_picture(k, name, drawing))
    designs = {n: r.design for n, r in results.items() if r.design is not None}
    if designs:
        content.append(_scores(designs))
    return content


def _picture(k: int, name: str, drawing: Drawing) -> Picture:
    points = text.count(len(drawing.tool_points), "reading")
    caption = f"{name}: machine at home and the tool points of {points}."
    return Picture(f"plan_{k}", lambda: draw_overview(drawing), caption)


def _scores(designs: Mapping[str, DesignSection]) -> Table:
    columns = [
        TableColumn("Result"),
        TableColumn("Criterion"),
        *number_columns("Readings", "Candidates", "log det", "κ", "Certified"),
    ]
    rows = [
        [
            name,
            design.criterion,
            str(design.n),
            str(design.candidates),
            text.fixed(design.plans[0].logdet, 2) if design.plans else text.MISSING,
            text.number(design.kappa, 4),
            text.percent_at_least(design.efficiency),
        ]
        for name, design in designs.items()
    ]
    caption = (
        "The chosen readings. log det: of their information; a larger one is better,"
        " where parameters and scaling are the same. κ: condition number. Certified:"
        " share of the best possible plan."
    )
    return Table(columns, rows, caption)
