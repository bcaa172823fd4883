"""Which readings to take, in which order: drawing, plan, stages, and other plans to compare with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Column,
    Items,
    Paragraph,
    Picture,
    Table,
    absent,
    number_column,
    text_column,
    transposed,
)
from pkm_reports.figures import machine

ANCHOR: Final = "plan"
TITLE: Final = "Machine and plan"
Part = Mapping[str, Any]


def blocks(result: Part) -> list[Block]:
    """Drawing, stages, the readings in order, plans compared."""
    design, drawing = result.get("design"), result.get("drawing")
    made: list[Block] = [Paragraph(_about(result["machine"]))]
    if drawing:
        made.append(Picture("machine", lambda: machine.draw(drawing), _seen(drawing)))
    made += _stages(result["plan"]) if result.get("plan") else []
    made += [*_plans(design), *_readings(design)] if design else absent("Choosing readings")
    return made


def _about(info: Part) -> str:
    text = f"{info['name']}: {words.sentence(info['about'])}"
    return f"{text} Source: {words.sentence(info['source'])}" if info.get("source") else text


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
    return f"{text} {words.count(len(tips), 'tool point')}{where}; together they span {reach}."


def _readings(design: Part) -> list[Block]:
    poses = design.get("poses") or []
    if not poses:
        return []
    commands = list(dict.fromkeys(key for pose in poses for key in pose["command"]))
    readings = list(dict.fromkeys(key for pose in poses for key in pose["reading"]))
    columns = [
        *text_column("Set-up", "Run"),
        *number_column("Order", *[words.heading(c) for c in commands]),
        *number_column(*[f"{words.heading(r)}, nominal" for r in readings]),
    ]
    cells = [[str(p["setup"]) for p in poses], [str(p["run"]) for p in poses], [str(p["order"]) for p in poses]]
    cells += [words.column([p["command"].get(c) for p in poses]) for c in commands]
    cells += [words.column([p["reading"].get(r) for p in poses]) for r in readings]
    return [Table(columns, transposed(cells), _told(poses))]


def _told(poses: Sequence[Part]) -> str:
    """Caption of the plan: what to do, set-up by set-up."""
    parts = []
    for setup in dict.fromkeys(str(p["setup"]) for p in poses):
        mine = [p for p in poses if p["setup"] == setup]
        runs = list(dict.fromkeys(str(p["run"]) for p in mine))
        parts.append(f"{words.count(len(mine), 'reading')} in {setup} ({words.listing(runs, 4)})")
    return f"The readings to take, from top to bottom: {words.listing(parts, 5)}. The machine is commanded to each row."


def _plans(design: Part) -> list[Block]:
    plans = design.get("plans") or []
    if not plans:
        return [Paragraph(_verdict(design))]
    names = list(dict.fromkeys(key for p in plans for key in p.get("observability") or {}))
    cells = [
        [str(p["name"]) for p in plans],
        [str(p["n"]) for p in plans],
        [words.fixed(p["logdet"], 2) for p in plans],
        [words.percent(p["efficiency"]) for p in plans],
        [words.num(p["kappa"], 4) for p in plans],
        *[[words.num((p.get("observability") or {}).get(o), 3) for p in plans] for o in names],
    ]
    gain = "D-efficiency" if all(p["criterion"] == "D" for p in plans) else "Efficiency"
    columns = [Column("Plan", wide=True), *number_column("Readings", "log det", gain, "κ", *names)]
    marks = ["chosen" if _is_chosen(p, design) else "" for p in plans]
    return [Paragraph(_verdict(design)), Table(columns, transposed(cells), _compared(design, plans), marks)]


def _is_chosen(score: Part, design: Part) -> bool:
    return score["name"] == "chosen" or all(score.get(key) == design.get(key) for key in ("n", "value", "kappa"))


def _verdict(design: Part) -> str:
    """What was optimised, out of how many candidates, and how far from the bound it ended."""
    text = f"{words.count(design['n'], 'reading')} were chosen"
    if design.get("candidates"):
        text += f" out of {words.count(design['candidates'], 'candidate')}"
    text += f" by criterion {design['criterion']}, which they bring to {words.num(design['value'], 4)}"
    if design.get("bound") is not None:
        text += f"; no choice can pass {words.num(design['bound'], 4)}"
    if design.get("efficiency") is not None:
        text += f" (efficiency {words.percent(design['efficiency'])})"
    return f"{text}. Scaling of the parameters: {design['scaling']}."


def _compared(design: Part, plans: Sequence[Part]) -> str:
    """Caption of the comparison: the chosen plan against the best and worst of the others."""
    text = "The chosen plan (marked) and plans to compare it with. Higher log det is better, lower κ is better."
    mine = [p for p in plans if _is_chosen(p, design)]
    others = [p for p in plans if not _is_chosen(p, design) and words.number(p["efficiency"]) > 0.0]
    if not mine or not others or not words.number(mine[0]["efficiency"]) > 0.0:
        return text
    rival = max(others, key=lambda p: words.number(p["efficiency"]))
    share = words.number(rival["efficiency"]) / words.number(mine[0]["efficiency"])
    if share > 1.0:
        return f"{text} The plan “{rival['name']}” is ahead of the chosen one."
    text += f" The next best, “{rival['name']}”, is worth {words.percent(share)} of the chosen one"
    if rival["criterion"] != "D" or rival["n"] != mine[0]["n"]:
        return f"{text}."
    # D-efficiency grows in proportion to the number of readings.
    more = math.ceil(rival["n"] / share - rival["n"])
    return f"{text}: it would take about {words.count(more, 'reading')} more to learn as much."


def _stages(plan: Part) -> list[Block]:
    stages = plan.get("stages") or []
    others = [words.sentence(text) for text in plan.get("alternatives") or []]
    extra: list[Block] = [Paragraph("Alternatives that were looked at:"), Items(others)] if others else []
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
    columns = [Column("Stage", number=True), *text_column("Measurement", "Set-ups")]
    columns += number_column("Readings", "Identifies", "Cost [min]", "κ")
    columns.append(Column("Predicted afterwards", wide=True))
    caption = f"The plan as stages, in order; together {words.quantity(plan['cost'], 'min')} of machine time."
    return [Table(columns, transposed(cells), caption), *extra]
