"""Circles of readings, with their residuals about the circle."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from oed.base import Array
from oed.result import GapSection, Trace
from pkm_reports import text

if TYPE_CHECKING:
    from pkm_reports.view.scene import ViewReading

#: circles that the page shows
MOST: Final = 12
#: readings of a circle, at least
LEAST: Final = 8
#: spread of the radii and height above the plane, as shares of the radius
ROUND: Final = 0.02


@dataclasses.dataclass(frozen=True, slots=True)
class CirclePass:
    """One way round: angles in degrees, residuals before and after.

    readings    numbers of the readings, from 0; empty where they are not known
    """

    name: str
    at: list[float]
    before: list[float]
    after: list[float]
    readings: list[int]


@dataclasses.dataclass(frozen=True, slots=True)
class Circle:
    """A circle with all its passes; `unit` is that of the residuals."""

    name: str
    unit: str
    passes: list[CirclePass]


def circles(gap: GapSection | None, readings: Sequence[ViewReading]) -> list[Circle]:
    """Circles of a diagnosis, or of the fitted readings where there is none."""
    if gap is not None and any(trace.kind == "circle" for trace in gap.traces):
        return _trace_circles(gap.traces)
    return _reading_circles(readings)


def _trace_circles(traces: Sequence[Trace]) -> list[Circle]:
    passes: dict[tuple[str, str, str, str], list[Trace]] = {}
    for trace in traces:
        if trace.kind == "circle":
            key = (trace.setup, trace.base, trace.channel, _load(trace))
            passes.setdefault(key, []).append(trace)
    return [
        Circle(
            name=text.cleaned(f"{setup}, {base}, {channel}{load}"),
            unit=text.unit_symbol(runs[0].unit),
            passes=[
                CirclePass(text.cleaned(t.run), t.at, t.before, t.after, [])
                for t in runs
            ],
        )
        for (setup, base, channel, load), runs in list(passes.items())[:MOST]
    ]


def _load(trace: Trace) -> str:
    return "" if trace.payload is None else f", {text.trimmed(trace.payload, 3)} N"


def _reading_circles(readings: Sequence[ViewReading]) -> list[Circle]:
    runs: dict[tuple[str, str], list[int]] = {}
    for k, reading in enumerate(readings):
        if len(reading.residuals) == 1:
            runs.setdefault((reading.setup, reading.run), []).append(k)
    drawn = []
    for (setup, run), members in runs.items():
        angles = angles_on_circle(np.array([readings[k].at for k in members]))
        if angles is None:
            continue
        order = [int(k) for k in np.argsort(angles, kind="stable")]
        entries = [readings[members[k]].residuals[0] for k in order]
        whole = CirclePass(
            name=run,
            at=[round(float(angles[k]), 2) for k in order],
            before=[entry.before for entry in entries],
            after=[entry.after for entry in entries],
            readings=[members[k] for k in order],
        )
        drawn.append(Circle(f"{setup}, {run}", entries[0].unit, [whole]))
    return drawn[:MOST]


def angles_on_circle(points: Array) -> Array | None:
    """Angles (n,), deg, of points (n, 3) about their circle; None where they form none.

    The centre is that of the least-squares circle in the plane of the points.
    """
    if len(points) < LEAST:
        return None
    offset = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(offset, full_matrices=False)
    plane, height = offset @ axes[:2].T, offset @ axes[2]
    system = np.column_stack([2.0 * plane, np.ones(len(plane))])
    centre = np.linalg.lstsq(system, np.sum(plane**2, axis=1), rcond=None)[0][:2]
    around = plane - centre
    radii = np.linalg.norm(around, axis=1)
    radius = float(radii.mean())
    if not radius > 0.0 or radii.std() > ROUND * radius:
        return None
    if np.abs(height).max() > ROUND * radius:
        return None
    return np.asarray(np.degrees(np.arctan2(around[:, 1], around[:, 0])) % 360.0)
