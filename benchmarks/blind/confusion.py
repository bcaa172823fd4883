"""Confusion matrix: what acts against what was answered, printed and as a picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.blind.entries import DIAGNOSIS, Entry
from benchmarks.blind.judge import StatedAnswer, names_exactly
from benchmarks.blind.selection import visible

NONE, UNKNOWN, SEVERAL, FAILED = "none", "unknown", "several", "failed"
#: the library's order, as readers know it
ORDER = (
    "leg_thermal",
    "frame_thermal",
    "bar_thermal",
    "gravity",
    "frame_bending",
    "joint_clearance",
    "backlash",
    "friction",
    "servo_lag",
    "encoder_scale",
    "bar_length",
    "pitch_accumulation",
    "screw_cyclic",
    "encoder_subdivision",
    "guideway",
    "joint_runout",
    "mount_drift",
    "step",
)


@dataclasses.dataclass(frozen=True)
class Confusion:
    """Counts of cases: rows are what acts, columns what was answered."""

    counts: pd.DataFrame

    @property
    def shares(self) -> pd.DataFrame:
        """Each row over its sum."""
        return self.counts.div(self.counts.sum(axis=1), axis=0)


def confusion(entries: Sequence[Entry], method: str = DIAGNOSIS) -> Confusion:
    """Matrix of null cases and of single effects (known, exact, unknown).

    Effects have sqrt(lambda) >= 6. A class that has the true effect counts as the true
    effect, another as its first name. An unknown remainder with one name does not
    count; `several` are more names than one.
    """
    acted, answered = [], []
    for e in entries:
        if e.kind in ("pair", "known_unknown") or method not in e.best:
            continue
        if e.kind != "null" and not visible(e):
            continue
        acted.append(_truth(e))
        answered.append(_answer(e, e.best[method]))
    acts = pd.Series(acted, dtype=object)
    counts = pd.crosstab(acts, pd.Series(answered, dtype=object))
    further = sorted(set(acted) - {*ORDER, NONE})
    rows = [r for r in (*ORDER, *further, NONE) if r in counts.index]
    columns = [*ORDER, UNKNOWN, SEVERAL, NONE, FAILED]
    counts = counts.reindex(index=rows, columns=columns, fill_value=0)
    always = {UNKNOWN, NONE, *rows}
    counts = counts[[c for c in columns if c in always or counts[c].any()]]
    counts.index.name, counts.columns.name = "acts", "answered"
    return Confusion(counts)


def _truth(e: Entry) -> str:
    if e.kind == "null":
        return NONE
    name = str(e.label["effects"][0]["name"])
    return f"({name})" if e.unknown else name


def _answer(e: Entry, a: StatedAnswer | None) -> str:
    if a is None:
        return FAILED
    if len(a.classes) > 1:
        return SEVERAL
    if not a.classes:
        return UNKNOWN if a.unknown else NONE
    if e.known and names_exactly(a, e.known):
        return e.known[0]
    return a.classes[0][0]


def text(matrix: Confusion) -> str:
    """The matrix to print: numbered columns, with their key below; dots for zeros."""
    counts = matrix.counts
    width = max(len(str(r)) for r in counts.index) + 2
    lines = [" " * width + "".join(f"{k + 1:>4}" for k in range(counts.shape[1]))]
    for name, row in counts.iterrows():
        cells = [f"{'.' if v == 0 else v:>4}" for v in row]
        lines.append(f"{name!s:<{width}}" + "".join(cells))
    columns = [f"{k} {c}" for k, c in enumerate(counts.columns, start=1)]
    lines.append("answered: " + ", ".join(columns))
    return "\n".join(lines)


def picture(matrix: Confusion, path: Path, title: str) -> None:
    """Draw the shares of each row with the counts written in.

    Effects that are in no library are in brackets.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator

    counts, shares = matrix.counts.to_numpy(), matrix.shares.to_numpy()
    height, width = counts.shape
    size = (2.9 + 0.36 * width, 2.4 + 0.27 * height)
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    image = axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), count in np.ndenumerate(counts):
        if count:
            acts = str(matrix.counts.index[i])
            answered = str(matrix.counts.columns[j])
            right = answered == (UNKNOWN if acts.startswith("(") else acts)
            colour = "white" if shares[i, j] > 0.55 else "black"
            weight = "bold" if right else "normal"
            axes.text(
                j,
                i,
                str(count),
                ha="center",
                va="center",
                fontsize=7,
                color=colour,
                fontweight=weight,
            )
    axes.set_xticks(
        range(width),
        [_words(c) for c in matrix.counts.columns],
        rotation=55,
        ha="right",
        fontsize=8,
    )
    sums = counts.sum(axis=1)
    labels = [
        f"{_words(r)}  ({n})" for r, n in zip(matrix.counts.index, sums, strict=True)
    ]
    axes.set_yticks(range(height), labels, fontsize=8)
    axes.xaxis.set_minor_locator(FixedLocator(np.arange(-0.5, width).tolist()))
    axes.yaxis.set_minor_locator(FixedLocator(np.arange(-0.5, height).tolist()))
    axes.grid(which="minor", color="0.85", linewidth=0.5)
    axes.tick_params(which="both", length=0)
    axes.set_xlabel("answered")
    axes.set_ylabel("acts (cases)")
    axes.set_title(title, fontsize=10)
    figure.colorbar(image, ax=axes, label="share of the row", fraction=0.03, pad=0.01)
    figure.savefig(path)


def _words(name: object) -> str:
    return str(name).replace("_", " ")
