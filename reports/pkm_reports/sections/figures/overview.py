"""The machine at home with all readings, small, for the first page."""

from __future__ import annotations

from typing import Any, Final

from matplotlib.figure import Figure

from oed.result import Drawing
from pkm_reports import style
from pkm_reports.sections.figures import machine

#: inches: readable at the width of a telephone
WIDTH, HEIGHT = 3.4, 3.0
#: legend entries side by side
COLUMNS: Final = 2


def draw_overview(drawing: Drawing) -> Figure:
    """One view of machine, bars and tool points, with a short legend."""
    shown = machine.scene_of(drawing)
    figure = style.placed_figure(HEIGHT, WIDTH)
    entries = machine.legend_entries(shown)
    lines = -(-len(entries) // COLUMNS)
    foot = (0.08 + machine.LEGEND_LINE * lines) / HEIGHT
    machine.panel(figure, (0.0, foot, 1.0, 1.0), shown, shown.whole_box())
    legend: Any = {"ncols": COLUMNS, "borderaxespad": 0.1, "columnspacing": 1.0}
    figure.legend(handles=entries, loc="lower center", **legend)
    return figure
