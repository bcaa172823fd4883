"""A figure of a report and the labels of its log axes: what derives from Matplotlib's classes.

`style` imports this with the first figure, so that sentences and tables need no Matplotlib.
"""

from typing import Any

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import Formatter

from pkm_reports import text


class ReportFigure(Figure):
    """A figure whose layout is computed without a first drawing that nobody sees."""

    def draw(self, renderer: Any) -> None:
        """Draw, or compute the layout alone where the file is drawn right after."""
        self._skip_absent_texts()
        precedes = self.canvas.is_saving() and bool(self.axes)
        if not (precedes and self.lay_out()):
            super().draw(renderer)

    def lay_out(self) -> bool:
        """Give the axes of a grid their places; whether the figure has such a layout."""
        engine = self.get_layout_engine()
        if not isinstance(engine, ConstrainedLayoutEngine):
            return False
        # after a save matplotlib gives its default layout to a figure that had none
        if any(axes.get_subplotspec() is not None for axes in self.axes):
            engine.execute(self)
        return True

    def _skip_absent_texts(self) -> None:
        """Seek no place for titles and labels that are not there.

        To find one, matplotlib measures all labels of the ticks anew.
        """
        for axes in self.axes:
            titles = axes.get_title("left"), axes.get_title(), axes.get_title("right")
            if not any(titles):
                axes.set_title("", y=1.0)
            for axis in (axes.xaxis, axes.yaxis):
                if not axis.get_label_text():
                    axis.set_label_coords(0.5, 0.0)


class PlainLog(Formatter):
    """Labels of a log axis: 0.01, 1, 100, and 10⁻⁶ where that is too long."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Label of one tick."""
        return text.trimmed(x, 3) if x > 0 else ""
