"""The confusion matrix: what acts against what was answered, printed, as CSV and as a
picture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.blind.entries import DIAGNOSIS, Entry
from benchmarks.blind.judge import Said, exactly
from benchmarks.blind.measures import SEEN, TOLERANCE

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
    """Counts (rows, columns) of what acts and what was answered, and each row's number
    of cases.
    """

    counts: pd.DataFrame

    @property
    def shares(self) -> pd.DataFrame:
        """Each row over its sum."""
        return self.counts.div(self.counts.sum(axis=1), axis=0)


def confusion(entries: Sequence[Entry], method: str = DIAGNOSIS) -> Confusion:
    """Of null cases and of single effects (known, exact, unknown) at sqrt(lambda) >= 6.

    A class that holds the true effect counts as the true effect, another as its first
    name; an unknown remainder beside one name is left out; `several`: more names than
    one, none of them alone.
    """
    acted, answered = [], []
    for e in entries:
        if e.kind in ("pair", "known_unknown") or method not in e.said:
            continue
        if e.kind != "null" and e.severity < SEEN * (1.0 - TOLERANCE):
            continue
        acted.append(_truth(e))
        answered.append(_answer(e, e.said[method]))
    counts = pd.crosstab(
        pd.Series(acted, dtype=object), pd.Series(answered, dtype=object)
    )
    rows = [*ORDER, *sorted(set(acted) - {*ORDER, NONE}), NONE]
    columns = [*ORDER, UNKNOWN, SEVERAL, NONE, FAILED]
    counts = counts.reindex(
        index=[r for r in rows if r in counts.index], columns=columns, fill_value=0
    )
    seen = [
        c
        for c in columns
        if c in (UNKNOWN, NONE) or c in counts.index or counts[c].any()
    ]
    counts = counts[seen]
    counts.index.name, counts.columns.name = "acts", "answered"
    return Confusion(counts)


def _truth(e: Entry) -> str:
    if e.kind == "null":
        return NONE
    name = str(e.label["effects"][0]["name"])
    return f"({name})" if e.unknown else name


def _answer(e: Entry, a: Said | None) -> str:
    if a is None:
        return FAILED
    if len(a.classes) > 1:
        return SEVERAL
    if not a.classes:
        return UNKNOWN if a.unknown else NONE
    return e.known[0] if e.known and exactly(a, e.known) else a.classes[0][0]


def text(made: Confusion) -> str:
    """The matrix to print: numbered columns, with their key below; dots for zeros."""
    counts = made.counts
    width = max(len(str(r)) for r in counts.index) + 2
    lines = [" " * width + "".join(f"{k + 1:>4}" for k in range(counts.shape[1]))]
    for name, row in counts.iterrows():
        lines.append(
            f"{name!s:<{width}}" + "".join(f"{'.' if v == 0 else v:>4}" for v in row)
        )
    lines.append(
        "answered: " + ", ".join(f"{k + 1} {c}" for k, c in enumerate(counts.columns))
    )
    return "\n".join(lines)


def picture(made: Confusion, path: Path, title: str) -> None:
    """Shares of each row as a picture with the counts written in; effects of nobody's
    library in brackets.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FixedLocator

    counts, shares = made.counts.to_numpy(), made.shares.to_numpy()
    high, wide = counts.shape
    figure = Figure(
        figsize=(2.9 + 0.36 * wide, 2.4 + 0.27 * high), dpi=150, layout="constrained"
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    shown = axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), count in np.ndenumerate(counts):
        if count:
            acts, told = str(made.counts.index[i]), str(made.counts.columns[j])
            right = told == (UNKNOWN if acts.startswith("(") else acts)
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
        range(wide),
        [_words(c) for c in made.counts.columns],
        rotation=55,
        ha="right",
        fontsize=8,
    )
    sums = counts.sum(axis=1)
    labels = [
        f"{_words(r)}  ({n})" for r, n in zip(made.counts.index, sums, strict=True)
    ]
    axes.set_yticks(range(high), labels, fontsize=8)
    axes.xaxis.set_minor_locator(FixedLocator(np.arange(-0.5, wide).tolist()))
    axes.yaxis.set_minor_locator(FixedLocator(np.arange(-0.5, high).tolist()))
    axes.grid(which="minor", color="0.85", linewidth=0.5)
    axes.tick_params(which="both", length=0)
    axes.set_xlabel("answered")
    axes.set_ylabel("acts (cases)")
    axes.set_title(title, fontsize=10)
    figure.colorbar(shown, ax=axes, label="share of the row", fraction=0.03, pad=0.01)
    figure.savefig(path)


def _words(name: object) -> str:
    return str(name).replace("_", " ")
