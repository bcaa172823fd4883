"""The look of all figures: sizes, colours for colour-blind readers, axes and legends."""

from __future__ import annotations

import base64
import dataclasses
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from oed.text import shorten

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure as Figure

    from pkm_reports.style.report_figure import ReportFigure

#: inches; the text width of an A4 page, so that figures keep their letter size in print
FIGURE_WIDTH: Final = 6.7

INK, GREY, LIGHT = "#1f2933", "#7b8794", "#cbd2d9"
BLUE, ORANGE, GREEN, RED = "#0072b2", "#e69f00", "#009e73", "#d55e00"
SKY, PINK, BROWN = "#56b4e9", "#cc79a7", "#8c6d1f"
#: background of a marked range
SHADE: Final = "#eef1f4"
#: colours of categories, in the order in which they are used (Okabe and Ito)
CYCLE: Final = (BLUE, ORANGE, GREEN, RED, SKY, PINK, BROWN, GREY)
#: look of what virtual machines reached, a diamond
DIAMOND: Final[dict[str, Any]] = {"color": ORANGE, "mec": INK, "mew": 0.6, "ms": 5}
PALE: Final = (ORANGE, SKY, PINK)  #: colours too light for white letters
MARKERS: Final = ("o", "s", "D", "^", "v", "P", "X", "h")
AMOUNT: Final = "YlGnBu"  #: colour map of amounts, light for little and dark for much

MAX_SVG: Final = 300_000  #: above this many bytes a figure is stored as pixels
PIXELS_PER_INCH: Final = 180
#: characters of all legend entries that fit side by side, and those of a marker
LEGEND_CHARACTERS: Final = 110
MARKER_CHARACTERS: Final = 7
#: range of a log axis (factor) below which it is labelled at 1, 2, 5, and evenly
LOG_LABEL_MAX_RANGE: Final = 150.0
SHORT_AXIS_MAX_RANGE: Final = 6.0

RC: Final[dict[str, Any]] = {
    "axes.axisbelow": True,
    "axes.edgecolor": GREY,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.unicode_minus": True,
    "figure.constrained_layout.use": True,
    "font.family": ["DejaVu Sans"],
    "font.size": 8.0,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.6,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
    "patch.linewidth": 0.6,
    "savefig.facecolor": "white",
    # Letters are drawn as paths: the reader's machine needs no font.
    "svg.fonttype": "path",
    # A fixed salt gives the same identifiers, hence the same bytes, each time.
    "svg.hashsalt": "pkm_reports",
    "text.color": INK,
    # Names may hold a dollar sign.
    "text.parse_math": False,
    "xtick.color": INK,
    "xtick.labelsize": 7.5,
    "ytick.color": INK,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
}


# -- figures and images ----------------------------------------------------------------
@dataclasses.dataclass(frozen=True, slots=True)
class Image:
    """A rendered figure.

    data             bytes of an SVG or PNG file
    kind             svg or png
    width, height    inches
    """

    data: bytes
    kind: str
    width: float
    height: float

    @property
    def uri(self) -> str:
        """The image as a data URI: its identifiers clash with no other image."""
        media = {"svg": "image/svg+xml", "png": "image/png"}[self.kind]
        return f"data:{media};base64,{base64.b64encode(self.data).decode('ascii')}"


@contextmanager
def applied() -> Iterator[None]:
    """Draw in this style, whatever the user's own matplotlib settings are."""
    import matplotlib.style

    with matplotlib.style.context(RC, after_reset=True):
        yield


def figure(height: float, width: float = FIGURE_WIDTH) -> ReportFigure:
    """An empty figure, in inches, without pyplot: no window system, no global state."""
    from pkm_reports.style.report_figure import ReportFigure

    return ReportFigure(figsize=(width, height))


def placed_figure(height: float, width: float = FIGURE_WIDTH) -> ReportFigure:
    """As `figure`, for axes that are placed by hand: no layout moves them."""
    from pkm_reports.style.report_figure import ReportFigure

    layout: Any = "none"  # which matplotlib's types forget
    return ReportFigure(figsize=(width, height), layout=layout)


def empty(message: str) -> Figure:
    """A figure that says why it shows nothing."""
    blank = figure(1.0)
    look: Any = {"ha": "center", "va": "center", "color": GREY, "fontsize": 9}
    blank.text(0.5, 0.5, label(message, 120), **look)
    return blank


def render(drawn: Figure) -> Image:
    """SVG where it stays small, else PNG; the same figure gives the same bytes."""
    width, height = drawn.get_size_inches()
    data = _saved(drawn, "svg", {"Date": None, "Creator": None})
    if len(data) <= MAX_SVG:
        return Image(data, "svg", width, height)
    return Image(_saved(drawn, "png", {"Software": None}), "png", width, height)


def _saved(drawn: Figure, kind: str, metadata: Mapping[str, None]) -> bytes:
    buffer = io.BytesIO()
    drawn.savefig(buffer, format=kind, metadata=metadata, dpi=PIXELS_PER_INCH)
    return buffer.getvalue()


# -- labels, markers, colours ----------------------------------------------------------
@cache
def _glyphs() -> frozenset[int]:
    from matplotlib import font_manager, ft2font

    path = font_manager.findfont("DejaVu Sans")
    return frozenset(ft2font.FT2Font(path).get_charmap())


def label(phrase: str, longest: int = 30) -> str:
    """Text that can be drawn: one short line, `?` for characters that the font lacks."""
    line = shorten(phrase, longest)
    return "".join(sign if ord(sign) in _glyphs() else "?" for sign in line)


def marker(k: int) -> str:
    """The k-th marker; markers and colours run apart, so that pairs repeat late."""
    return MARKERS[(k + k // len(CYCLE)) % len(MARKERS)]


def colours(names: Sequence[str]) -> dict[str, str]:
    """A colour for each distinct name, in order of appearance."""
    distinct = list(dict.fromkeys(names))
    return {name: CYCLE[k % len(CYCLE)] for k, name in enumerate(distinct)}


def log_axis(axes: Axes, which: str) -> None:
    """Give an axis a log scale with plain labels: even, 1, 2, 5, or a decade apart."""
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

    from pkm_reports.style.report_figure import PlainLog

    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    low, high = sorted(getattr(axes, f"get_{which}lim")())
    narrow = high < LOG_LABEL_MAX_RANGE * low
    steps = (1.0, 2.0, 5.0) if narrow else (1.0,)
    axis.set_major_locator(LogLocator(subs=steps, numticks=12))
    axis.set_major_formatter(PlainLog())
    axis.set_minor_formatter(NullFormatter())
    axis.set_minor_locator(NullLocator() if narrow else LogLocator(subs=(2.0, 5.0)))
    if high < SHORT_AXIS_MAX_RANGE * low:
        few_ticks(axis, 5, steps=[1, 2, 5, 10])


def few_ticks(axis: Axis, most: int, **options: Any) -> None:
    """At most so many ticks, at round numbers."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(most, **options))


def ticks_every(axis: Axis, step: float) -> None:
    """Ticks at the multiples of a step."""
    from matplotlib.ticker import MultipleLocator

    axis.set_major_locator(MultipleLocator(step))


def ticks_at(axis: Axis, values: Sequence[float]) -> None:
    """Ticks at given values alone."""
    from matplotlib.ticker import FixedLocator

    axis.set_major_locator(FixedLocator(list(values)))


def fixed_ticks(
    axes: Axes, which: str, places: Sequence[float], labels: Sequence[str]
) -> None:
    """Put ticks at given places with given labels."""
    axis = getattr(axes, f"{which}axis")
    ticks_at(axis, places)
    axis.set_ticklabels([label(phrase) for phrase in labels])
    axis.minorticks_off()


def hide(panels: Iterable[Axes]) -> None:
    """Hide the panels of a grid that nothing is drawn in."""
    for axes in panels:
        axes.set_visible(False)


def legend_entries(panels: Iterable[Axes]) -> dict[str, Artist]:
    """Legend entries of all panels by their label, each once."""
    entries: dict[str, Artist] = {}
    for axes in panels:
        for handle, phrase in zip(*axes.get_legend_handles_labels(), strict=True):
            entries[phrase] = handle
    return entries


def legend_columns(labels: Sequence[str]) -> int:
    """How many entries of a legend below the figure stand side by side."""
    longest = max(map(len, labels), default=1)
    fitting = LEGEND_CHARACTERS // (MARKER_CHARACTERS + longest)
    return max(1, min(len(labels), fitting))


def legend_below(
    drawn: Figure, entries: Mapping[str, Artist], columns: int | None = None
) -> None:
    """A legend below all panels, in as many columns as fit or as are given."""
    labels = list(entries)
    drawn.legend(
        list(entries.values()),
        labels,
        loc="outside lower center",
        ncols=legend_columns(labels) if columns is None else columns,
    )
