"""Which readings to take, in which order: drawing, stages, working order, readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Items,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_column,
    text_column,
    transposed,
)
from pkm_reports.figures import machine
from pkm_reports.sections.parts import order

ANCHOR: Final = "plan"
TITLE: Final = "Machine and plan"
Part = Mapping[str, Any]


def blocks(result: Part) -> list[Block]:
    """Drawing, stages, the working order, the readings."""
    design, drawing = result.get("design"), result.get("drawing")
    made: list[Block] = [Paragraph(_about(result["machine"]))]
    if drawing:
        made.append(Picture("machine", lambda: machine.draw(drawing), _seen(drawing)))
    made += _stages(result["plan"]) if result.get("plan") else []
    return made + (
        [Paragraph(_chosen(design)), *order.blocks(design), *_readings(design)]
        if design
        else []
    )


def _about(info: Part) -> str:
    text = f"{info['name']}: {words.sentence(info['about'])}"
    return (
        f"{text} Source: {words.sentence(info['source'])}"
        if info.get("source")
        else text
    )


def _seen(drawing: Part) -> str:
    """Caption of the drawing: how many readings where, and how far they reach."""
    names = list(drawing.get("reading_of") or [])
    tips = machine.points(drawing.get("tool_points") or [])
    told = words.listing((f"{names.count(n)} in {n}" for n in dict.fromkeys(names)), 5)
    text = "The machine at its home pose in the base frame, equal scale on all axes."
    if not len(tips):
        return text
    x, y, z = np.ptp(tips, axis=0)
    reach = f"{words.num(x)} × {words.num(y)} × {words.num(z)}{words.GAP}mm (x, y, z)"
    where = f": {told}" if names else ""
    return (
        f"{text} {words.count(len(tips), 'tool point')}{where}; together they span"
        f" {reach}."
    )


def _readings(design: Part) -> list[Block]:
    poses = design.get("poses") or []
    if not poses:
        return []
    commands = list(dict.fromkeys(key for pose in poses for key in pose["command"]))
    readings = list(dict.fromkeys(key for pose in poses for key in pose["reading"]))
    columns = [
        TableColumn("No.", number=True),
        *text_column("Set-up", "Run"),
        *number_column("Order in run", *[words.heading(c) for c in commands]),
        *number_column(*[f"{words.heading(r)}, nominal" for r in readings]),
    ]
    cells = [[str(k) for k in range(1, len(poses) + 1)]]
    cells += [[str(p[key]) for p in poses] for key in ("setup", "run", "order")]
    cells += [words.column([p["command"].get(c) for p in poses]) for c in commands]
    cells += [words.column([p["reading"].get(r) for p in poses]) for r in readings]
    return [Table(columns, transposed(cells), _told(poses))]


def _told(poses: Sequence[Part]) -> str:
    """Caption of the plan: what to do, set-up by set-up."""
    parts = []
    for setup in dict.fromkeys(str(p["setup"]) for p in poses):
        mine = [p for p in poses if p["setup"] == setup]
        runs = list(dict.fromkeys(str(p["run"]) for p in mine))
        named = f" ({words.listing(runs, 4)})" if runs != ["1"] else ""
        parts.append(f"{words.count(len(mine), 'reading')} in {setup}{named}")
    return (
        f"The readings to take, from top to bottom: {words.listing(parts, 5)}. The"
        " machine is commanded to each row."
    )


def _chosen(design: Part) -> str:
    """What was chosen, by what, out of how many."""
    text = f"{words.count(design['n'], 'reading')} were chosen"
    if design.get("candidates"):
        text += f" out of {words.count(design['candidates'], 'candidate')}"
    text += f" by criterion {design['criterion']}"
    kept = design.get("kept") or 0
    text += f"; {kept} of them belonged to the plan before" if kept else ""
    return f"{text}. How good the choice is known to be is told in the next chapter."


def _stages(plan: Part) -> list[Block]:
    stages = plan.get("stages") or []
    others = [words.sentence(text) for text in plan.get("alternatives") or []]
    extra: list[Block] = (
        [Paragraph("Alternatives that were looked at:"), Items(others)]
        if others
        else []
    )
    if not stages:
        return extra
    cells = [
        [str(k + 1) for k in range(len(stages))],
        [str(s["measurement"]) for s in stages],
        [words.listing(s["setups"]) for s in stages],
        [str(s["readings"]) for s in stages],
        [str(s["identifies"]) for s in stages],
        [words.num(s["cost"]) for s in stages],
        [words.num(s["kappa"], 4) for s in stages],
        [words.numbers(s.get("predicted") or {}, 3) for s in stages],
    ]
    columns = [
        TableColumn("Stage", number=True),
        TableColumn("Measurement"),
        TableColumn("Set-ups", wide=True),
    ]
    columns += number_column("Readings", "Identifies", "Cost [min]", "κ")
    columns.append(TableColumn("Predicted afterwards", wide=True))
    caption = (
        f"The plan as stages, in order; together {words.quantity(plan['cost'], 'min')}"
        " of machine time."
    )
    return [Table(columns, transposed(cells), caption), *extra]
