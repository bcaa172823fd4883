"""Error after compensation over the workspace, as a map for each component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from oed.base import Array
from oed.result import PredictionSection
from pkm_reports import missing, style, text
from pkm_reports.sections.figures.map_layout import MapLayout, choose_layout

MOST_ROWS: Final = 3
#: decimals to which commands are compared
DECIMALS: Final = 9
#: share of a grid's cells from which the poses count as a grid
FILLED: Final = 0.4
#: factor between the errors from which colours are logarithmic
WIDE: Final = 6.0
QUARTERS: Final = np.radians([0.0, 90.0, 180.0, 270.0]).tolist()


def draw(prediction: PredictionSection) -> Figure:
    """A row for each component, a panel for each height, one colour scale for a row."""
    names = shown_components(prediction)
    if not prediction.map or not names:
        return style.empty("No map over the workspace is stored in this result.")
    commands = {
        name: missing.column([point.command for point in prediction.map], name)
        for name in prediction.map[0].command
    }
    if len(commands) < 2:
        return _line_over_command(prediction, commands, names)
    layout = choose_layout(commands)
    panels = len(layout.levels)
    # Single panels stand side by side; otherwise each component has a row.
    rows, columns = (len(names), panels) if panels > 1 else (1, len(names))
    figure = style.figure(0.35 + 2.05 * rows + (0.6 if panels == 1 else 0.0))
    kind: Any = {"projection": "polar"} if layout.polar else {}
    grid = figure.subplots(rows, columns, squeeze=False, subplot_kw=kind)
    grid = grid.reshape(len(names), panels)
    for k, (row, name) in enumerate(zip(grid, names, strict=True)):
        _row(figure, row, layout, commands, name, prediction)
        for axes, level in zip(row, layout.levels, strict=True):
            title = _level_title(layout, level) if k == 0 or panels == 1 else ""
            axes.set_title(title, loc="center", fontsize=7.5, fontweight="normal")
    return figure


def shown_components(prediction: PredictionSection) -> list[str]:
    """Up to three components, those that the controller can correct if there are any."""
    components = prediction.components
    correctable = [name for name, c in components.items() if c.compensatable]
    return (correctable or list(components))[:MOST_ROWS]


def errors(prediction: PredictionSection, name: str) -> Array:
    """Error of a component after compensation at each pose of the map (n,)."""
    return missing.column([point.after for point in prediction.map], name)


def _row(
    figure: Figure,
    row: Any,
    layout: MapLayout,
    commands: Mapping[str, Array],
    name: str,
    prediction: PredictionSection,
) -> None:
    """The panels of one component and their colour bar."""
    values = errors(prediction, name)
    norm = _norm(values)
    for axes, level in zip(row, layout.levels, strict=True):
        at_level = layout.poses_at(level, commands)
        across = commands[layout.across][at_level]
        up = commands[layout.up][at_level]
        image = _panel(axes, across, up, values[at_level], layout, norm)
    single = len(row) == 1
    place: Any = {"location": "bottom" if single else "right"}
    place["pad"] = 0.03 if single else 0.02
    label = style.label(_error_label(prediction, name))
    bar: Any = figure.colorbar(
        image,
        ax=list(row),
        shrink=0.85,
        label=label,
        **place,
    )
    bar.outline.set_visible(False)
    along = "x" if single else "y"
    if isinstance(norm, LogNorm):
        style.log_axis(bar.ax, along)
    else:
        getattr(bar.ax, f"{along}axis").set_major_locator(MaxNLocator(5))


def _error_label(prediction: PredictionSection, name: str) -> str:
    unit = text.unit_symbol(prediction.components[name].after.unit)
    return f"error of {name} [{unit}]"


def _level_title(layout: MapLayout, level: float) -> str:
    if layout.panel is None:
        return "all poses"
    stem, unit = text.split_unit(layout.panel)
    return style.label(f"{stem} = {text.number(level, 4)} {text.unit_symbol(unit)}")


def _norm(values: Array) -> Normalize:
    """Linear colours, or logarithmic ones where a few poses would outshine the others."""
    low = float(np.nanmin(values, initial=np.inf))
    high = float(np.nanmax(values, initial=-np.inf))
    if not np.isfinite(low):
        return Normalize(0.0, 1.0)
    if low > 0.0 and high > WIDE * low:
        return LogNorm(low, high)
    return Normalize(min(low, 0.8 * high), high if high > low else low + 1.0)


def _panel(
    axes: Any,
    across: Array,
    up: Array,
    values: Array,
    layout: MapLayout,
    norm: Normalize,
) -> Any:
    if layout.polar:
        across = np.radians(across)
    cells = _cells(across, up, values)
    shade: Any = {"cmap": style.AMOUNT, "norm": norm}
    if cells is None:
        marks: Any = {"s": 26, "ec": style.GREY, "lw": 0.3}
        image = axes.scatter(across, up, c=values, **shade, **marks)
    else:
        image = axes.pcolormesh(*cells, rasterized=True, **shade)
    if layout.polar:
        _set_polar_axes(axes, up)
    else:
        _set_cartesian_axes(axes, layout)
    return image


def _cells(
    across: Array, up: Array, values: Array
) -> tuple[Array, Array, Array] | None:
    """Cell edges and a grid of values with gaps as NaN; None where there is no grid."""
    across, up = across.round(DECIMALS), up.round(DECIMALS)
    xs, ys = np.unique(across), np.unique(up)
    cells = len(xs) * len(ys)
    if min(len(xs), len(ys)) < 2 or len(values) < FILLED * cells:
        return None
    grid = np.full((len(ys), len(xs)), np.nan)
    grid[np.searchsorted(ys, up), np.searchsorted(xs, across)] = values
    return _edges(xs), _edges(ys), grid


def _edges(x: Array) -> Array:
    """Cell edges halfway between neighbours."""
    middle = (x[1:] + x[:-1]) / 2.0
    first, last = 2.0 * x[0] - middle[0], 2.0 * x[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


def _set_polar_axes(axes: Any, up: Array) -> None:
    """No tilt in the centre; labels outside the coloured cells."""
    tilts = np.unique(up)
    axes.grid(False)
    outer = _edges(tilts)[-1] if len(tilts) > 1 else 1.1 * tilts[-1]
    axes.set_rlim(0.0, float(outer))
    axes.yaxis.set_major_locator(NullLocator())
    axes.xaxis.set_major_locator(FixedLocator(QUARTERS))
    axes.set_xticklabels(["0°", "90°", "180°", "270°"], fontsize=6)
    axes.tick_params(axis="x", pad=-2)
    axes.spines["polar"].set_visible(False)


def _set_cartesian_axes(axes: Axes, layout: MapLayout) -> None:
    axes.grid(False)
    if text.split_unit(layout.across)[1] == text.split_unit(layout.up)[1]:
        axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel=text.heading(layout.across), ylabel=text.heading(layout.up))
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))


def _line_over_command(
    prediction: PredictionSection, commands: Mapping[str, Array], names: Sequence[str]
) -> Figure:
    """The error of a machine with one command, along that command."""
    ((command, values),) = commands.items()
    figure = style.figure(2.4)
    axes = figure.subplots()
    order = np.argsort(values)
    for name in names:
        unit = text.unit_symbol(prediction.components[name].after.unit)
        label = style.label(f"{name} [{unit}]")
        axes.plot(values[order], errors(prediction, name)[order], "o-", label=label)
    axes.set(xlabel=text.heading(command), ylabel="error after compensation")
    axes.legend()
    return figure
