"""How many readings a wanted accuracy needs, and what no plan of a size can reach."""

from __future__ import annotations

from oed.result import DesignSection, HowManySummary
from pkm_reports.figures import how_many
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Paragraph, Picture


def blocks(design: DesignSection) -> list[Block]:
    """A sentence, and accuracy over the number of readings."""
    summary = design.how_many
    if summary is None:
        return []
    caption = _caption(summary)
    return [
        Paragraph(_sentence(summary)),
        Picture("how_many", lambda: how_many.draw(summary), caption),
    ]


def _sentence(summary: HowManySummary) -> str:
    """The sentence of the study, or the same from the numbers."""
    wanted = text.named_quantities(summary.wanted, 4)
    if summary.words:
        verdict = text.sentence(summary.words)
        return f"Wanted: {wanted}. {verdict}" if summary.wanted else verdict
    if not summary.wanted:
        return (
            "The study asks for no accuracy: the figure shows what each number of"
            " readings reaches."
        )
    if summary.fewest is None:
        return (
            f"No plan found with up to {summary.most} readings reaches {wanted}; none"
            f" with fewer than {summary.at_least} can."
        )
    readings = text.count(summary.fewest, "reading")
    if summary.fewest == summary.at_least:
        return f"A plan of {readings} reaches {wanted}; fewer cannot (proven)."
    return (
        f"A plan of {readings} reaches {wanted}; fewer than {summary.at_least} readings"
        " cannot."
    )


def _caption(summary: HowManySummary) -> str:
    """First and last point of each curve."""
    caption = (
        "Predicted rms error over the number of readings, both on log scales. Dots are"
        " plans found; no plan of as many readings lies in the shaded region."
    )
    sizes = summary.sizes
    ranges = []
    for key, values in summary.accuracy.items():
        if len(values) == len(sizes) > 1:
            stem, unit = text.split_unit(key)
            first, last = (
                text.quantity(values[0], unit),
                text.quantity(values[-1], unit),
            )
            ranges.append(f"{stem} from {first} to {last}")
    if not ranges:
        return caption
    return f"{caption} From {sizes[0]} to {sizes[-1]} readings: {text.listing(ranges)}."
