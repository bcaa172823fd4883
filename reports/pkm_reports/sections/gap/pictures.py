"""Residuals as figures: run by run, on circles, over the workspace."""

from __future__ import annotations

from collections.abc import Sequence

from oed.result import GapSection, Trace
from pkm_reports.figures.gap import map as gap_map
from pkm_reports.figures.gap import polar as gap_polar
from pkm_reports.figures.gap import trace as gap_trace
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Picture


def blocks(gap: GapSection) -> list[Block]:
    """Traces, circles where there are any, map."""
    traces, spots = gap.traces, gap.spots
    if not traces:
        return []
    caption = _trace_caption(traces)
    content: list[Block] = [
        Picture("gap_trace", lambda: gap_trace.draw(traces), caption)
    ]
    if gap_polar.circles(traces):
        caption = _polar_caption(traces)
        content.append(Picture("gap_polar", lambda: gap_polar.draw(traces), caption))
    if spots:
        caption = _map_caption(gap)
        unit = gap.spots_unit
        content.append(Picture("gap_map", lambda: gap_map.draw(spots, unit), caption))
    return content


def _trace_caption(traces: Sequence[Trace]) -> str:
    colours = ["grey after calibration"]
    if gap_polar.explains(traces):
        colours += [
            "orange the part that the effects found explain",
            "blue the residual with these effects in the model",
        ]
    if any(value != 0.0 for trace in traces for value in trace.unexplained):
        colours.append("pink a part of a form that no known effect has")
    single_channel = len({trace.channel for trace in traces}) == 1
    noun = "run" if single_channel else "trace"
    shown, runs = len(gap_trace.choose(traces)), text.count(len(traces), noun)
    extent = f"{runs}."
    if shown < len(traces):
        extent = f"Shown are the {shown} of {runs} with the largest residuals before."
    return f"Residual of each run: {', '.join(colours)}. {extent}"


def _polar_caption(traces: Sequence[Trace]) -> str:
    caption = "Circles as a ball bar draws them"
    if gap_polar.explains(traces):
        caption += (
            ", above before and below after the effects found are in the model. The"
            " residual is magnified about the thin circle, equally above and below"
        )
    else:
        caption += ". The residual is magnified about the thin circle"
    caption += "; the bar in the centre gives its scale."
    circles = {gap_polar.circle_key(t) for t in traces if t.kind == "circle"}
    shown = len(gap_polar.circles(traces))
    if shown < len(circles):
        return (
            f"{caption} Shown are the {shown} of {len(circles)} circles with the largest"
            " residuals."
        )
    return f"{caption} {text.count(len(circles), 'circle')}."


def _map_caption(gap: GapSection) -> str:
    caption = "Residual by place of the tool"
    if gap_polar.explains(gap.traces):
        caption += (
            ", before and after the effects found are in the model, with one scale"
        )
    places = text.count(len(gap.spots), "place")
    return f"{caption}. {places}; readings at one place are taken together."
