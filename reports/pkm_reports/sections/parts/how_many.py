"""How many readings it takes for a wanted accuracy, and what no plan of so many can
reach.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pkm_reports import words
from pkm_reports.blocks import Block, Paragraph, Picture
from pkm_reports.figures import how_many

Part = Mapping[str, Any]


def blocks(design: Part) -> list[Block]:
    """A sentence, and accuracy over the number of readings."""
    part = design.get("how_many")
    if not part:
        return []
    return [
        Paragraph(_sentence(part)),
        Picture("how_many", lambda: how_many.draw(part), _caption(part)),
    ]


def _sentence(part: Part) -> str:
    """The study's own words, or the same from the numbers."""
    wanted = words.numbers(part.get("wanted") or {}, 4)
    if part.get("words"):
        told = words.sentence(str(part["words"]))
        return f"Wanted: {wanted}. {told}" if part.get("wanted") else told
    if not part.get("wanted"):
        return (
            "No accuracy was asked for: the figure tells what each number of readings"
            " brings."
        )
    fewest, least, most = part.get("fewest"), part.get("at_least"), part.get("most")
    if fewest is None:
        return (
            f"No plan of up to {most} readings was found that reaches {wanted}; fewer"
            f" than {least} can not."
        )
    if fewest == least:
        return (
            f"{words.count(fewest, 'reading')} reach {wanted}, and fewer can not: that"
            " is proven."
        )
    return (
        f"{words.count(fewest, 'reading')} reach {wanted}; fewer than {least} can not."
    )


def _caption(part: Part) -> str:
    """First and last point of each curve."""
    text = (
        "Predicted rms error over the number of readings, both on log scales. Dots are"
        " plans that were found; no plan of as many readings lies in the shade."
    )
    sizes = part.get("sizes") or []
    told = []
    for key, values in (part.get("accuracy") or {}).items():
        if len(values) == len(sizes) > 1:
            stem, unit = words.parted(key)
            told.append(
                f"{stem} from {words.quantity(values[0], unit)} to"
                f" {words.quantity(values[-1], unit)}"
            )
    return (
        f"{text} From {sizes[0]} to {sizes[-1]} readings: {words.listing(told)}."
        if told
        else text
    )
