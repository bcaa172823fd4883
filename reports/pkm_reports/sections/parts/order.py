"""The working order, set-up by set-up, and the way through the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pkm_reports import words
from pkm_reports.blocks import Block, Items, Paragraph, Picture
from pkm_reports.figures import path

Part = Mapping[str, Any]


def blocks(design: Part) -> list[Block]:
    """Set-ups in order, travel and time, the way."""
    poses, order = design.get("poses") or [], design.get("order")
    made: list[Block] = [Paragraph(_travel(order))] if order else []
    setups = (order or {}).get("setups") or design.get("setups") or []
    if len(setups) > 1:
        made += [
            Paragraph("Set-ups, in working order:"),
            Items([_setup(n, poses) for n in setups], numbered=True),
        ]
    if any(pose.get("command") for pose in poses):
        made.append(Picture("path", lambda: path.draw(poses), _caption(poses)))
    return made


def _travel(order: Part) -> str:
    before, after = (
        words.number(order.get("before_s")),
        words.number(order.get("after_s")),
    )
    text = f"In working order the joints travel for {words.quantity(after, 's')}"
    if before > after:
        less = words.percent(1.0 - after / before)
        text += (
            f", {less} less than the {words.quantity(before, 's')} in the order of the"
            " candidates"
        )
    text += ": proven the shortest way within each set-up" if order.get("exact") else ""
    references = order.get("references") or 0
    if references:
        text += (
            f". {words.count(references, 'thermal reference reading')}"
            f" {'is' if references == 1 else 'are'} put between"
        )
    minutes = order.get("minutes")
    return (
        f"{text}. Mounting, travel and readings take {words.quantity(minutes, 'min')}"
        " together."
        if minutes
        else text + "."
    )


def _setup(name: str, poses: Sequence[Part]) -> str:
    """How many readings, and which of the table."""
    mine = [k for k, pose in enumerate(poses, 1) if pose["setup"] == name]
    if not mine:
        return str(name)
    text = f"{name}: {words.count(len(mine), 'reading')}"
    return (
        f"{text}, no. {mine[0]} to {mine[-1]}"
        if mine[-1] - mine[0] == len(mine) - 1 > 0
        else text
    )


def _caption(poses: Sequence[Part]) -> str:
    plane = path.chosen(poses)
    told = words.count(len(poses), "reading")
    text = (
        f"The way through the poses of the {told} in working order; numbers are those"
        " of the table."
    )
    if plane is None:
        return text
    text += f" Shown: {words.listing(words.parted(n)[0] for n in plane.names)}"
    others = [
        n
        for n in dict.fromkeys(k for p in poses for k in p.get("command") or {})
        if n not in plane.names
    ]
    text += (
        f" (not shown: {words.listing(words.parted(n)[0] for n in others)})."
        if others
        else "."
    )
    if path.around(plane, [str(p["setup"]) for p in poses]):
        text += (
            " A way over a full turn leaves on one side and comes back on the other."
        )
    setups = len({str(p["setup"]) for p in poses})
    left = setups - path.MOST_PANELS
    return text + (f" {left} further set-ups are left out." if left > 0 else "")
