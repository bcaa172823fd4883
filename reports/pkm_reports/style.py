"""One look for all figures: sizes, colours that colour-blind readers can tell apart,
plain-text labels.
"""

from __future__ import annotations

import base64
import dataclasses
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, Final

import matplotlib.style
import numpy as np
from matplotlib import font_manager, ft2font
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    Formatter,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
)

from pkm_reports import words

#: inches; the text width of an A4 page, so that figures keep their letter size in print
WIDTH: Final = 6.7

INK, GREY, LIGHT = "#1f2933", "#7b8794", "#cbd2d9"
BLUE, ORANGE, GREEN, RED, SKY, PINK = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#d55e00",
    "#56b4e9",
    "#cc79a7",
)
#: categories, in the order in which they are given out (Okabe and Ito)
CYCLE: Final = (BLUE, ORANGE, GREEN, RED, SKY, PINK, "#8c6d1f", GREY)
#: colours too light for white letters
PALE: Final = (ORANGE, SKY, PINK)
MARKERS: Final = ("o", "s", "D", "^", "v", "P", "X", "h")
#: amounts, light for little and dark for much
AMOUNT: Final = "YlGnBu"

#: above this many bytes a figure is stored as pixels
LARGEST_SVG: Final = 300_000
PIXELS_PER_INCH: Final = 180

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
    "svg.fonttype": "path",  # no font of the reader's machine is needed
    "svg.hashsalt": (
        "pkm_reports"
    ),  # the same identifiers, hence the same bytes, each time
    "text.color": INK,
    "text.parse_math": False,  # names may hold a dollar sign
    "xtick.color": INK,
    "xtick.labelsize": 7.5,
    "ytick.color": INK,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
}


@dataclasses.dataclass(frozen=True, slots=True)
class Image:
    """A rendered figure: bytes of an SVG or PNG file, and its shape."""

    data: bytes
    kind: str  # svg | png
    width: float  # inches
    height: float

    @property
    def uri(self) -> str:
        """The image as a data URI: it needs no second file, and its identifiers clash
        with no other image.
        """
        media = {"svg": "image/svg+xml", "png": "image/png"}[self.kind]
        return f"data:{media};base64,{base64.b64encode(self.data).decode('ascii')}"


@contextmanager
def applied() -> Iterator[None]:
    """The house style, whatever the user's own matplotlib settings are."""
    with matplotlib.style.context(RC, after_reset=True):
        yield


def figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure, inches; built without pyplot, so no window system and no global
    state.
    """
    return Figure(figsize=(width, height))


def empty(message: str) -> Figure:
    """A figure that says why it shows nothing."""
    drawn = figure(1.0)
    drawn.text(
        0.5, 0.5, safe(message, 120), ha="center", va="center", color=GREY, fontsize=9
    )
    return drawn


def render(drawn: Figure) -> Image:
    """SVG where it stays small, else PNG; the same figure gives the same bytes."""
    data = _saved(drawn, "svg", {"Date": None, "Creator": None})
    if len(data) <= LARGEST_SVG:
        return Image(data, "svg", *drawn.get_size_inches())
    return Image(
        _saved(drawn, "png", {"Software": None}), "png", *drawn.get_size_inches()
    )


def _saved(drawn: Figure, kind: str, metadata: dict[str, None]) -> bytes:
    buffer = io.BytesIO()
    drawn.savefig(buffer, format=kind, metadata=metadata, dpi=PIXELS_PER_INCH)
    return buffer.getvalue()


@cache
def _glyphs() -> frozenset[int]:
    path = font_manager.findfont("DejaVu Sans")
    return frozenset(ft2font.FT2Font(path).get_charmap())


def safe(text: str, longest: int = 30) -> str:
    """A label that can be drawn: one line, cut where too long, `?` for signs that the
    font lacks.
    """
    line = " ".join(str(text).split())
    line = line if len(line) <= longest else line[: longest - 1].rstrip() + "…"
    return "".join(sign if ord(sign) in _glyphs() else "?" for sign in line)


def marker(k: int) -> str:
    """The k-th marker; shifted against the colours, so that colour and marker together
    repeat late.
    """
    return MARKERS[(k + k // len(CYCLE)) % len(MARKERS)]


def colours(names: Sequence[str]) -> dict[str, str]:
    """A colour for each distinct name, in order of appearance."""
    distinct = list(dict.fromkeys(names))
    return {name: CYCLE[k % len(CYCLE)] for k, name in enumerate(distinct)}


class PlainLog(Formatter):
    """Labels of a log axis: 0.01, 1, 100, and 10⁻⁶ where that is too long."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Label of one tick."""
        return words.plain(x, 3) if x > 0 else ""


def legend_columns(labels: Sequence[str]) -> int:
    """How many entries of a legend below the figure stand side by side."""
    return max(1, min(len(labels), 110 // (7 + max(map(len, labels), default=1))))


def log_axis(axes: Axes, which: str) -> None:
    """Logarithmic scale with plain labels; a range of under two decades is labelled at
    1, 2, 5, a short one evenly.
    """
    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    low, high = sorted(getattr(axes, f"get_{which}lim")())
    narrow = high < 150.0 * low
    axis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,), numticks=12)
    )
    axis.set_major_formatter(PlainLog())
    axis.set_minor_formatter(NullFormatter())
    if narrow:
        axis.set_minor_locator(NullLocator())
    if high < 6.0 * low:
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))


def fixed_ticks(
    axes: Axes, which: str, places: Sequence[float], labels: Sequence[str]
) -> None:
    """Ticks at given places with given (safe) labels."""
    axis = getattr(axes, f"{which}axis")
    axis.set_major_locator(FixedLocator(list(places)))
    axis.set_ticklabels([safe(label) for label in labels])
    axis.set_minor_locator(NullLocator())


def array(values: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Numbers from JSON as floats; null (a number that was not finite) becomes NaN."""
    return np.array(values, dtype=object).astype(float) if len(values) else np.zeros(0)
