"""The working order of the readings: set-ups, travel and time, and the path."""

from __future__ import annotations

from collections.abc import Sequence

from oed.result import DesignSection, PlannedReading, WorkingOrder
from pkm_reports.figures import path
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Items, Paragraph, Picture


def blocks(design: DesignSection) -> list[Block]:
    """Travel, set-ups in order, path through the poses."""
    poses, order = design.poses, design.order
    content: list[Block] = []
    setups = design.setups
    if order is not None:
        content.append(Paragraph(_travel(order)))
        setups = order.setups or setups
    if len(setups) > 1:
        items = [_setup(name, poses) for name in setups]
        content += [
            Paragraph("Set-ups, in working order:"),
            Items(items, numbered=True),
        ]
    if any(pose.command for pose in poses):
        content.append(Picture("path", lambda: path.draw(poses), _caption(poses)))
    return content


def _travel(order: WorkingOrder) -> str:
    before, after = order.before_s, order.after_s
    travel = f"In working order the joints travel for {text.quantity(after, 's')}"
    if before > after:
        saved = text.percent(1.0 - after / before)
        travel += (
            f", {saved} less than the {text.quantity(before, 's')} in the order of the"
            " candidates"
        )
    sentences = [f"{travel}."]
    if order.exact:
        sentences.append("Within each set-up no path is shorter (proven).")
    if order.references:
        readings = text.count(order.references, "thermal reference reading")
        verb = "is" if order.references == 1 else "are"
        sentences.append(f"{readings} {verb} put between.")
    if order.minutes:
        minutes = text.quantity(order.minutes, "min")
        sentences.append(f"Mounting, travel and readings take {minutes} together.")
    return " ".join(sentences)


def _setup(name: str, poses: Sequence[PlannedReading]) -> str:
    """How many readings, and which of the table."""
    numbers = [k for k, pose in enumerate(poses, 1) if pose.setup == name]
    if not numbers:
        return name
    first, last = numbers[0], numbers[-1]
    entry = f"{name}: {text.count(len(numbers), 'reading')}"
    consecutive = last - first == len(numbers) - 1
    if len(numbers) > 1 and consecutive:
        return f"{entry}, no. {first} to {last}"
    return entry


def _caption(poses: Sequence[PlannedReading]) -> str:
    readings = text.count(len(poses), "reading")
    sentences = [
        f"The path through the {readings} in working order; the numbers are those of"
        " the table."
    ]
    plane = path.choose_plane(poses)
    if plane is None:
        return sentences[0]
    hidden = [name for name in path.coordinates(poses) if name not in plane.names]
    axes = f"Shown: {_stems(plane.names)}"
    sentences.append(f"{axes} (not shown: {_stems(hidden)})." if hidden else f"{axes}.")
    if path.crosses_edge(plane, [pose.setup for pose in poses]):
        sentences.append(
            "A path over a full turn leaves the figure on one side and returns on the"
            " other."
        )
    more = len({pose.setup for pose in poses}) - path.MOST_PANELS
    if more > 0:
        sentences.append(f"{more} more set-ups are not shown.")
    return " ".join(sentences)


def _stems(names: Sequence[str]) -> str:
    return text.listing(text.split_unit(name)[0] for name in names)
