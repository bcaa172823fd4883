"""Regions of the selected effects: their columns by leg and set-up, and by run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from oed.arrays import Array, Mask
from oed.gap.data.problem import GapProblem
from oed.gap.place.regions import Region, runs
from oed.gap.place.session import cell_starts, clock, time_span

#: form of a region with selected columns
SELECTED = "selected"
#: change of a reading, against the largest, up to which it is none
NOTHING = 1e-6
#: number of selected columns up to which they are looked for in each run
FEW = 8
#: kinds of blocks that an effect's columns may belong to
BLOCKS = ("leg", "set-up")


def selected_effects(
    problem: GapProblem,
    columns: Array | None,
    labels: Sequence[str] | None,
) -> Iterator[Region]:
    """The selected effects' own columns of each leg and set-up, and in each run."""
    if columns is None or labels is None:
        return
    if columns.shape != (len(problem), len(labels)):
        raise ValueError(
            f"columns have the shape {columns.shape}; ({len(problem)}, {len(labels)})"
            " fits the labels"
        )
    for name in dict.fromkeys(labels):
        block = columns[:, [label == name for label in labels]]
        for kind in BLOCKS:
            if name.startswith(f"{kind} "):
                yield Region(kind, name, block)
        yield from _stretch(problem, block)
        yield from _touched_runs(problem, block)
    if 0 < columns.shape[1] <= FEW:
        for k, (place, inside) in enumerate(runs(problem)):
            basis = inside[:, None] * columns
            yield Region("run", place, basis, frozenset({k}), SELECTED)


def _changed(columns: Array) -> Mask:
    """Which readings (N,) columns (N, k) change."""
    size = np.abs(columns).max(axis=1, initial=0.0)
    largest = max(float(size.max(initial=0.0)), 1e-300)
    return np.asarray(size > NOTHING * largest)


def _stretch(problem: GapProblem, columns: Array) -> Iterator[Region]:
    """The stretch of the session outside which columns (N, k) change nothing, if any.

    What changes at the session's start is reported from its end on, as by time windows.
    """
    starts, times = cell_starts(problem), clock(problem)
    inside = _changed(columns) & np.isfinite(times)
    if len(starts) < 2 or not inside.any():
        return
    first, last = float(times[inside].min()), float(times[inside].max())
    end = float(np.nanmax(times))
    if first <= starts[0] and last >= end:
        return
    if first <= starts[0]:
        first, last = float(times[times > last].min()), end
    low, high = np.searchsorted(starts, [first, last], side="right") - 1
    cells = frozenset(range(int(low), int(high) + 1))
    yield Region("time", time_span(times, first, last), columns, cells, SELECTED)


def _touched_runs(problem: GapProblem, columns: Array) -> Iterator[Region]:
    """The runs outside which columns (N, k) change nothing, if there are any.

    Each of them is a region with all of the columns.
    """
    changed, every = _changed(columns), list(runs(problem))
    touched = []
    for k, (place, inside) in enumerate(every):
        if changed[inside > 0.0].any():
            touched.append((k, place))
    if len(touched) < len(every):
        for k, place in touched:
            yield Region("run", place, columns, frozenset({k}), SELECTED)
