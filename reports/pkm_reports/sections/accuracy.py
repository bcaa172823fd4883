"""How accurate the machine is before and after, component by component and over the
workspace.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from pkm_reports import style, words
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    absent,
    number_column,
)
from pkm_reports.figures import accuracy, budget, workspace

ANCHOR: Final = "accuracy"
TITLE: Final = "Residual accuracy"
Part = Mapping[str, Any]
REFERENCES: Final = {
    "absolute": "absolute: position and orientation in the base frame",
    "home": "relative to home: the machine is zeroed at its home pose",
    "best_fit": "after the best rigid fit: the workpiece is aligned to the machine",
}
MODES: Final = {
    "plan": "predicted before any reading is taken, from tolerances, plan and noise",
    "identified": "predicted with the identified parameters",
}
STATES: Final = ("before", "after", "known")


def blocks(result: Part) -> list[Block]:
    """Bars, table, budget, map."""
    part = result.get("prediction")
    if not part:
        return absent("A prediction of the accuracy over the workspace")
    parts = part.get("components") or {}
    made: list[Block] = [Paragraph(_about(part)), Paragraph(_verdict(parts))]
    made.append(Picture("accuracy", lambda: accuracy.draw(part), _bars(part)))
    made.append(_table(parts))
    if part.get("realised"):
        made.append(_realised(part))
    if any(p.get("budget") for p in parts.values()):
        made.append(Picture("budget", lambda: budget.draw(parts), _sources(parts)))
    if part.get("map"):
        made.append(Picture("workspace", lambda: workspace.draw(part), _where(part)))
    return made


def _about(part: Part) -> str:
    reference = REFERENCES.get(part["reference"], str(part["reference"]))
    mode = MODES.get(part["mode"], str(part["mode"]))
    return (
        f"Errors of the pose over {words.count(part['poses'], 'workspace pose')},"
        f" {mode}. Reference: {reference}. Numbers are 1-sigma errors, pooled over the"
        " workspace."
    )


def _verdict(parts: Mapping[str, Part]) -> str:
    """What the controller can correct, by how much, and what it cannot."""
    able = [_gain(name, p) for name, p in parts.items() if p["compensatable"]]
    rest = [_left(name, p) for name, p in parts.items() if not p["compensatable"]]
    text = (
        f"The controller can correct {words.listing(able)}. "
        if able
        else "The controller can correct none of them. "
    )
    if rest:
        text += (
            f"No axis moves the others alone: {words.listing(rest)}. A further axis, or"
            " knowing the error, would help."
        )
    return text.strip()


def _gain(name: str, part: Part) -> str:
    before, after = part["before"], part["after"]
    unit = str(after["unit"])
    return (
        f"{name} from {words.quantity(before['rms'], unit)} to"
        f" {words.quantity(after['rms'], unit)}"
    )


def _left(name: str, part: Part) -> str:
    unit = str(part["after"]["unit"])
    known = words.quantity(part["known"]["rms"], unit)
    return (
        f"{name} stays at {words.quantity(part['after']['rms'], unit)} (known to"
        f" {known})"
    )


def _bars(part: Part) -> str:
    parts = part["components"]
    text = (
        "Rms error of each component over the workspace, before and after, on a log"
        " scale."
    )
    if any(not p["compensatable"] for p in parts.values()):
        text += " A star marks components that the controller cannot correct."
    gains = {
        n: words.number(p["before"]["rms"]) / words.number(p["after"]["rms"])
        for n, p in parts.items()
        if p["compensatable"] and words.number(p["after"]["rms"]) > 0.0
    }
    if gains:
        most, least = (
            max(gains, key=lambda n: gains[n]),
            min(gains, key=lambda n: gains[n]),
        )
        text += (
            f" Calibration divides the error of {most} by {words.num(gains[most], 2)}"
        )
        same = words.num(gains[most], 2) == words.num(gains[least], 2)
        text += "." if same else f", of {least} by {words.num(gains[least], 2)}."
    return text


def _table(parts: Mapping[str, Part]) -> Table:
    columns = [TableColumn("Component"), TableColumn("Correctable")]
    states = STATES[:2] if accuracy.same(parts) else STATES
    for state in states:
        columns += number_column(f"{state}: rms", "p95", "max")
    rows = [_row(name, part, states) for name, part in parts.items()]
    caption = (
        "Errors before and after compensation: rms, 95th percentile and largest over"
        " the workspace."
    )
    if "known" in states:
        caption += (
            " Known: what remains where a further axis, or software, corrects the"
            " component as well."
        )
    return Table(columns, rows, caption)


def _row(name: str, part: Part, states: Sequence[str]) -> list[str]:
    spreads = [
        words.num(part[state][key]) for state in states for key in ("rms", "p95", "max")
    ]
    return [
        f"{name} [{words.unit(str(part['after']['unit']))}]",
        "yes" if part["compensatable"] else "no",
        *spreads,
    ]


def _realised(part: Part) -> Table:
    rows, ratios = [], []
    for name, spread in part["realised"].items():
        predicted = words.number(
            ((part["components"].get(name) or {}).get("after") or {}).get("rms")
        )
        ratio = (
            words.number(spread["rms"]) / predicted if predicted > 0.0 else float("nan")
        )
        ratios += [ratio] if np.isfinite(ratio) else []
        sizes = [words.num(spread[key]) for key in ("rms", "p95", "max")]
        rows.append(
            [
                f"{name} [{words.unit(str(spread['unit']))}]",
                *sizes,
                words.num(predicted),
                words.fixed(ratio, 2),
            ]
        )
    columns = [
        TableColumn("Component"),
        *number_column("Rms", "p95", "max", "Predicted rms", "Realised / predicted"),
    ]
    caption = "What a virtual machine with known errors showed after compensation."
    if ratios:
        caption += (
            f" Realised over predicted: {words.fixed(min(ratios), 2)} to"
            f" {words.fixed(max(ratios), 2)}."
        )
    return Table(columns, rows, caption)


def _sources(parts: Mapping[str, Part]) -> str:
    """Caption of the budget: the largest source of each component."""
    largest: dict[str, dict[str, float]] = {}
    for name, part in parts.items():
        shares = {k: words.number(v) for k, v in (part.get("budget") or {}).items()}
        if shares:
            source = max(shares, key=lambda k: shares[k])
            largest.setdefault(source, {})[name] = shares[source]
    told = [
        f"{source} for {words.listing(of)} (up to {words.percent(max(of.values()))})"
        for source, of in largest.items()
    ]
    return (
        "Where the variance that remains comes from. The largest source is"
        f" {words.listing(told)}: attack that first."
    )


def _where(part: Part) -> str:
    """Caption of the map: where each component is worst and best."""
    told = []
    for name in workspace.rows(part):
        values = style.array(
            [(spot.get("after") or {}).get(name) for spot in part["map"]]
        )
        if np.isfinite(values).any():
            unit = str((part.get("unit") or {}).get(name, ""))
            worst, best = (
                part["map"][int(np.nanargmax(values))],
                part["map"][int(np.nanargmin(values))],
            )
            most = (
                f"{words.quantity(np.nanmax(values), unit)}, at"
                f" {words.numbers(worst['command'], 4)}"
            )
            least = (
                f"{words.quantity(np.nanmin(values), unit)}, at"
                f" {words.numbers(best['command'], 4)}"
            )
            told.append(f"{name} is largest, {most}, and smallest, {least}.")
    polar = set(workspace.POLAR) <= set(part["map"][0]["command"])
    how = (
        " Direction in the picture: psi; distance from the centre: theta."
        if polar
        else ""
    )
    return f"1-sigma error after compensation over the workspace.{how} {' '.join(told)}"
