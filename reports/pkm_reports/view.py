"""What the page's views show: machine, readings, error map and gap as points.

PageView               of a result: its lines, readings, fields and circles
within_script          JSON as it may stand within a page's script
residuals_of_readings  the residuals of a result by reading
points_mm              points that are given in m, in mm
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.result import Drawing, GapSection, PredictionSection, StudyResult, Trace
from pkm_reports import text
from pkm_reports.missing import or_nan

Point = list[float]
Values = dict[str, Any]  #: by the names that the page's script reads

# Circles of readings, with their residuals about the circle.

MAX_CIRCLES: Final = 12  #: circles that the page shows
MIN_CIRCLE_READINGS: Final = 8  #: readings of a circle, at least
#: spread of the radii and height above the plane, as shares of the radius
CIRCLE_TOLERANCE: Final = 0.02


def circles(gap: GapSection | None, readings: Sequence[Values]) -> list[Values]:
    """Circles of a diagnosis, or of the fitted readings where there is none."""
    if gap is not None and any(trace.kind == "circle" for trace in gap.traces):
        return _trace_circles(gap.traces)
    return _reading_circles(readings)


def _trace_circles(traces: Sequence[Trace]) -> list[Values]:
    passes: dict[tuple[str, str, str, str], list[Trace]] = {}
    for trace in traces:
        if trace.kind == "circle":
            key = (trace.setup, trace.base, trace.channel, _load(trace))
            passes.setdefault(key, []).append(trace)
    return [
        {
            "name": text.cleaned(f"{setup}, {base}, {channel}{load}"),
            "unit": text.unit_symbol(runs[0].unit),
            "passes": [
                _pass(text.cleaned(t.run), t.at, t.before, t.after, []) for t in runs
            ],
        }
        for (setup, base, channel, load), runs in list(passes.items())[:MAX_CIRCLES]
    ]


def _load(trace: Trace) -> str:
    return "" if trace.payload is None else f", {text.trimmed(trace.payload, 3)} N"


def _reading_circles(readings: Sequence[Values]) -> list[Values]:
    runs: dict[tuple[str, str], list[int]] = {}
    for k, reading in enumerate(readings):
        if len(reading["residuals"]) == 1:
            runs.setdefault((reading["setup"], reading["run"]), []).append(k)
    drawn = []
    for (setup, run), members in runs.items():
        angles = angles_on_circle(np.array([readings[k]["at"] for k in members]))
        if angles is None:
            continue
        order = [int(k) for k in np.argsort(angles, kind="stable")]
        entries = [readings[members[k]]["residuals"][0] for k in order]
        whole = _pass(
            run,
            [round(float(angles[k]), 2) for k in order],
            [entry["before"] for entry in entries],
            [entry["after"] for entry in entries],
            [members[k] for k in order],
        )
        unit = entries[0]["unit"]
        drawn.append({"name": f"{setup}, {run}", "unit": unit, "passes": [whole]})
    return drawn[:MAX_CIRCLES]


def _pass(
    name: str,
    at: list[float],
    before: list[float],
    after: list[float],
    readings: list[int],
) -> Values:
    """One way round a circle."""
    sizes = {"before": before, "after": after}
    return {"name": name, "at": at, **sizes, "readings": readings}


def angles_on_circle(points: Array) -> Array | None:
    """Angles (n,), deg, of points (n, 3) about their least-squares circle; None without."""
    if len(points) < MIN_CIRCLE_READINGS:
        return None
    offset = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(offset, full_matrices=False)
    plane, height = offset @ axes[:2].T, offset @ axes[2]
    system = np.column_stack([2.0 * plane, np.ones(len(plane))])
    centre = np.linalg.lstsq(system, np.sum(plane**2, axis=1), rcond=None)[0][:2]
    around = plane - centre
    radii = np.linalg.norm(around, axis=1)
    radius = float(radii.mean())
    if not radius > 0.0 or radii.std() > CIRCLE_TOLERANCE * radius:
        return None
    if np.abs(height).max() > CIRCLE_TOLERANCE * radius:
        return None
    return np.asarray(np.degrees(np.arctan2(around[:, 1], around[:, 0])) % 360.0)


PLACE_DECIMALS: Final = 2  #: decimals of places, mm
ERROR_DIGITS: Final = 4  #: significant digits of errors
MAX_READINGS: Final = 5000  #: readings beyond which the page has no views


@dataclasses.dataclass(frozen=True, slots=True)
class PageView:
    """All that the views of one page show; places are in mm.

    lines     polylines: kind, points
    labels    names of parameters at the point that they move: at, text
    readings  set-up, run, command in words, where the tool is and the far end of what is
              measured, residuals by channel where the readings are fitted
    fields    sizes before and after at points, with words on where each is
    circles   each with its passes: angles in degrees, residuals before and after, and
              the numbers of the readings, from 0, where they are known
    """

    lines: list[Values]
    labels: list[Values]
    readings: list[Values]
    fields: list[Values]
    circles: list[Values]

    def encoded(self) -> str:
        """JSON for a script element: no character of it ends the element."""
        return within_script(msgspec.json.encode(self).decode("utf-8"))

    @classmethod
    def from_machine(
        cls, lines: Iterable[Array], labels: Iterable[tuple[Sequence[float], str]]
    ) -> PageView:
        """A machine without readings: polylines (n, 3), texts at points (3,), m."""
        drawn = [_line("machine", points_mm(line).tolist()) for line in lines]
        named = [_label(points_mm([at])[0].tolist(), words) for at, words in labels]
        return cls(drawn, named, [], [], [])

    @staticmethod
    def from_result(result: StudyResult) -> PageView | None:
        """The views of a result; None where nothing is drawn, or far too much."""
        drawing = result.drawing
        if drawing is None or not (drawing.lines or drawing.tool_points):
            return None
        if len(drawing.tool_points) > MAX_READINGS:
            return None
        lines = [_line(line.kind, _mm(line.points)) for line in drawing.lines]
        labels = [_label(_mm([label.at])[0], label.text) for label in drawing.labels]
        readings = _readings(result, drawing)
        shown = circles(result.gap, readings)
        return PageView(lines, labels, readings, _fields(result), shown)


def _line(kind: str, points: list[Point]) -> Values:
    return {"kind": kind, "points": points}


def _label(at: Point, words: str) -> Values:
    return {"at": at, "text": words}


def _readings(result: StudyResult, drawing: Drawing) -> list[Values]:
    count = len(drawing.tool_points)
    runs, commands = _runs_and_commands(result, drawing)
    fitted = residuals_of_readings(result, drawing)
    tips = _mm(drawing.tool_points)
    paired = len(drawing.bars) == count
    bars = drawing.bars if paired else [[]] * count
    far = [_mm(bar[:1])[0] if bar else None for bar in bars]
    setups = [*drawing.reading_of, *["reading"] * count][:count]
    return [
        {
            "setup": text.cleaned(setups[k]),
            "run": text.cleaned(runs[k]),
            "words": text.cleaned(text.named_quantities(commands[k], 4)),
            "at": tips[k],
            "far": far[k],
            "residuals": fitted[k],
        }
        for k in range(count)
    ]


def _runs_and_commands(
    result: StudyResult, drawing: Drawing
) -> tuple[Sequence[str], Sequence[Mapping[str, float]]]:
    """Of each tool point; from the planned readings where the drawing has none."""
    count = len(drawing.tool_points)
    if len(drawing.runs) == count == len(drawing.commands):
        return drawing.runs, drawing.commands
    poses = [] if result.design is None else result.design.poses
    if len(poses) == count:
        return [pose.run for pose in poses], [pose.command for pose in poses]
    return [""] * count, [{}] * count


def _fields(result: StudyResult) -> list[Values]:
    corrected = result.corrected
    prediction = result.prediction
    if corrected is not None and corrected.prediction is not None:
        prediction = corrected.prediction
    fields = [] if prediction is None else _error_fields(prediction)
    if result.gap is not None:
        fields += _gap_field(result.gap)
    return fields


def _error_fields(prediction: PredictionSection) -> list[Values]:
    points = [point for point in prediction.map if len(point.at) == 3]
    if not points:
        return []
    positions = _mm([point.at for point in points])
    phrases = [text.cleaned(text.named_quantities(p.command, 4)) for p in points]
    return [
        {
            "name": f"error of {text.cleaned(name)}",
            "unit": text.unit_symbol(component.after.unit),
            "at": positions,
            "words": phrases,
            "before": [rounded(point.before[name]) for point in points],
            "after": [rounded(point.after[name]) for point in points],
        }
        for name, component in prediction.components.items()
    ]


def _gap_field(gap: GapSection) -> list[Values]:
    if not gap.spots:
        return []
    return [
        {
            "name": "residual of the readings",
            "unit": text.unit_symbol(gap.spots_unit),
            "at": [_round(spot.at) for spot in gap.spots],
            "words": ["" for _ in gap.spots],
            "before": [rounded(spot.before) for spot in gap.spots],
            "after": [rounded(spot.after) for spot in gap.spots],
        }
    ]


def rounded(value: float | None) -> float | None:
    """A size with few digits; None where there is none."""
    x = or_nan(value)
    return float(f"{x:.{ERROR_DIGITS}g}") if np.isfinite(x) else None


def _mm(points: Sequence[Sequence[float]]) -> list[Point]:
    return [_round(point) for point in points_mm(points)]


def _round(point: Sequence[float] | Array) -> Point:
    return [round(float(v), PLACE_DECIMALS) for v in point]


def residuals_of_readings(result: StudyResult, drawing: Drawing) -> list[list[Values]]:
    """For each tool point its channels' residuals; empty lists where they do not match."""
    estimate = result.estimate
    count = len(drawing.tool_points)
    nothing: list[list[Values]] = [[] for _ in range(count)]
    channels_of = {setup.name: len(setup.sigma) for setup in result.setups}
    if estimate is None or not set(drawing.reading_of) <= set(channels_of):
        return nothing
    channels = [channels_of[name] for name in drawing.reading_of]
    if len(channels) != count or sum(channels) != len(estimate.residuals):
        return nothing
    entries = [
        {
            "channel": text.cleaned(channel),
            "unit": text.unit_symbol(estimate.units[channel]),
            "before": round(before, 4),
            "after": round(after, 4),
        }
        for channel, before, after in zip(
            estimate.channels,
            estimate.residuals_before,
            estimate.residuals,
            strict=True,
        )
    ]
    listed = iter(entries)
    return [[next(listed) for _ in range(n)] for n in channels]


def within_script(encoded: str) -> str:
    """JSON none of whose characters ends the script element that it stands in."""
    for sign in "&<>":
        encoded = encoded.replace(sign, f"\\u{ord(sign):04x}")
    return encoded


def points_mm(points: Sequence[Sequence[float]] | Array) -> Array:
    """Points (n, 3) given in m, in mm."""
    return units.from_si(np.array(points, dtype=float).reshape(-1, 3), "mm")
