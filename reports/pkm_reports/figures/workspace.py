"""Error after compensation, drawn over the workspace."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

from oed.arrays import Array
from pkm_reports import style, words

POLAR: Final = ("psi_deg", "theta_deg")
MOST_ROWS: Final = 3
MOST_LEVELS: Final = 4
CLOSE_LEVELS: Final = 8


@dataclasses.dataclass(frozen=True, slots=True)
class MapLayout:
    """Which commands are the axes, which one makes the panels, and at which of its
    values.
    """

    across: str
    up: str
    panel: str | None
    levels: list[float]

    @property
    def polar(self) -> bool:
        """Tilt azimuth as angle, tilt as radius."""
        return (self.across, self.up) == POLAR


def draw(prediction: Mapping[str, Any]) -> Figure:
    """A row for each component, a panel for each height; colours share a scale within a
    row.
    """
    spots = prediction.get("map") or []
    names = rows(prediction)
    if not spots or not names:
        return style.empty("No map over the workspace is stored in this result.")
    commands = {
        key: style.array([spot["command"].get(key) for spot in spots])
        for key in spots[0]["command"]
    }
    if len(commands) < 2:
        return _along_one(prediction, commands, names)
    plan = choose(commands)
    panels = len(plan.levels)
    # With one panel for each component they stand side by side, else each component has
    # a row.
    shape = (len(names), panels) if panels > 1 else (1, len(names))
    figure = style.figure(0.35 + 2.05 * shape[0] + (0.6 if panels == 1 else 0.0))
    kind: Any = {"projection": "polar"} if plan.polar else {}
    grid = figure.subplots(*shape, squeeze=False, subplot_kw=kind).reshape(
        len(names), panels
    )
    for k, (row, name) in enumerate(zip(grid, names, strict=True)):
        _row(figure, row, plan, commands, name, prediction)
        for axes, level in zip(row, plan.levels, strict=True):
            title = _level(plan, level) if k == 0 or panels == 1 else ""
            axes.set_title(title, loc="center", fontsize=7.5, fontweight="normal")
    return figure


def rows(prediction: Mapping[str, Any]) -> list[str]:
    """Up to three components to show: those that the controller can correct, if there
    are any.
    """
    parts = prediction.get("components") or {}
    kept = [name for name, part in parts.items() if part.get("compensatable")]
    return (kept or list(parts))[:MOST_ROWS]


def choose(commands: Mapping[str, Array]) -> MapLayout:
    """Polar axes for psi and theta; otherwise the first two commands that vary."""
    varying = [k for k, v in commands.items() if np.ptp(v) > 0] + [
        k for k, v in commands.items() if np.ptp(v) == 0
    ]
    axes = POLAR if set(POLAR) <= set(commands) else (varying[0], varying[1])
    rest = [k for k in varying if k not in axes]
    levels = np.unique(commands[rest[0]]) if rest else np.zeros(0)
    if not rest or len(levels) > CLOSE_LEVELS:
        return MapLayout(*axes, None, [np.nan])
    picked = np.unique(
        np.linspace(0, len(levels) - 1, min(MOST_LEVELS, len(levels)))
        .round()
        .astype(int)
    )
    return MapLayout(*axes, rest[0], levels[picked].tolist())


def _row(
    figure: Figure,
    row: Any,
    plan: MapLayout,
    commands: Mapping[str, Array],
    name: str,
    prediction: Mapping[str, Any],
) -> None:
    values = style.array(
        [(spot.get("after") or {}).get(name) for spot in prediction["map"]]
    )
    norm = _norm(values)
    for axes, level in zip(row, plan.levels, strict=True):
        chosen = (
            np.ones(len(values), bool)
            if plan.panel is None
            else commands[plan.panel] == level
        )
        drawn = _panel(
            axes,
            commands[plan.across][chosen],
            commands[plan.up][chosen],
            values[chosen],
            plan,
            norm,
        )
    unit = words.unit(str((prediction.get("unit") or {}).get(name, "")))
    side: Any = (
        {"location": "right", "pad": 0.02}
        if len(row) > 1
        else {"location": "bottom", "pad": 0.03}
    )
    bar: Any = figure.colorbar(
        drawn,
        ax=list(row),
        shrink=0.85,
        label=style.safe(f"error of {name} [{unit}]"),
        **side,
    )
    bar.outline.set_visible(False)
    along = "y" if len(row) > 1 else "x"
    if isinstance(norm, LogNorm):
        style.log_axis(bar.ax, along)
    else:
        getattr(bar.ax, f"{along}axis").set_major_locator(MaxNLocator(5))


def _level(plan: MapLayout, level: float) -> str:
    if plan.panel is None:
        return "all poses"
    stem, _, unit = plan.panel.rpartition("_")
    return style.safe(f"{stem} = {words.num(level, 4)} {words.unit(unit)}")


def _norm(values: Array) -> Normalize:
    """Linear colours, or logarithmic ones where a few poses would outshine all others."""
    low, high = (
        float(np.nanmin(values, initial=np.inf)),
        float(np.nanmax(values, initial=-np.inf)),
    )
    if not np.isfinite(low):
        return Normalize(0.0, 1.0)
    if low > 0.0 and high > 6.0 * low:
        return LogNorm(low, high)
    return Normalize(min(low, 0.8 * high), high if high > low else low + 1.0)


def _panel(
    axes: Any, across: Array, up: Array, values: Array, plan: MapLayout, norm: Normalize
) -> Any:
    if plan.polar:
        across = np.radians(across)
    table = _table(across, up, values)
    if table is None:
        drawn = axes.scatter(
            across,
            up,
            c=values,
            cmap=style.AMOUNT,
            norm=norm,
            s=26,
            ec=style.GREY,
            lw=0.3,
        )
    else:
        drawn = axes.pcolormesh(*table, cmap=style.AMOUNT, norm=norm, rasterized=True)
    _polar(axes, up) if plan.polar else _cartesian(axes, plan)
    return drawn


def _table(
    across: Array, up: Array, values: Array
) -> tuple[Array, Array, Array] | None:
    """Cell edges and a grid of values (gaps NaN), or None where the poses lie on no
    grid.
    """
    xs, ys = np.unique(across.round(9)), np.unique(up.round(9))
    if min(len(xs), len(ys)) < 2 or len(values) < 0.4 * len(xs) * len(ys):
        return None
    grid = np.full((len(ys), len(xs)), np.nan)
    grid[np.searchsorted(ys, up.round(9)), np.searchsorted(xs, across.round(9))] = (
        values
    )
    return _edges(xs), _edges(ys), grid


def _edges(x: Array) -> Array:
    """Cell edges halfway between neighbours."""
    middle = (x[1:] + x[:-1]) / 2.0
    return np.concatenate(
        [[2.0 * x[0] - middle[0]], middle, [2.0 * x[-1] - middle[-1]]]
    )


def _polar(axes: Any, up: Array) -> None:
    """No tilt in the centre; labels outside the coloured cells."""
    tilts = np.unique(up)
    axes.grid(False)
    axes.set_rlim(0.0, float(_edges(tilts)[-1] if len(tilts) > 1 else 1.1 * tilts[-1]))
    axes.yaxis.set_major_locator(NullLocator())
    axes.xaxis.set_major_locator(
        FixedLocator(np.radians([0.0, 90.0, 180.0, 270.0]).tolist())
    )
    axes.set_xticklabels(["0°", "90°", "180°", "270°"], fontsize=6)
    axes.tick_params(axis="x", pad=-2)
    axes.spines["polar"].set_visible(False)


def _cartesian(axes: Axes, plan: MapLayout) -> None:
    axes.grid(False)
    same = plan.across.rpartition("_")[2] == plan.up.rpartition("_")[2]
    if same:
        axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel=words.heading(plan.across), ylabel=words.heading(plan.up))
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))


def _along_one(
    prediction: Mapping[str, Any], commands: Mapping[str, Array], names: Sequence[str]
) -> Figure:
    """A machine with one command: the error along it."""
    ((key, at),) = commands.items()
    figure = style.figure(2.4)
    axes = figure.subplots()
    order = np.argsort(at)
    for name in names:
        values = style.array([spot["after"].get(name) for spot in prediction["map"]])
        unit = words.unit(str((prediction.get("unit") or {}).get(name, "")))
        axes.plot(at[order], values[order], "o-", label=style.safe(f"{name} [{unit}]"))
    axes.set(xlabel=words.heading(key), ylabel="error after compensation")
    axes.legend()
    return figure
