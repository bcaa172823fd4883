"""Posterior of the worst-seen directions: all pairs, and each against its tolerance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.arrays import Array
from pkm_reports import style

MOST: Final = 6
LONGEST_LABEL: Final = 18


def draw(posterior: Mapping[str, Any]) -> Figure:
    """Lower triangle: draws as a histogram in two dimensions; diagonal: histogram and
    the prior N(0, 1) in grey.
    """
    names, draws = shown(posterior)
    if not len(draws) or not names:
        return style.empty("No draws of the posterior are stored in this result.")
    k = len(names)
    figure = style.figure(
        0.6 + 1.15 * k, width=min(style.WIDTH, 0.8 + 1.25 * k) if k > 1 else 3.2
    )
    grid = figure.subplots(k, k, squeeze=False)
    limits = [_limits(draws[:, i]) for i in range(k)]
    for i in range(k):
        for j in range(k):
            _cell(grid[i, j], draws, limits, i, j)
    _labels(grid, names)
    figure.supxlabel(
        "prior standard deviations (tolerances)", fontsize=7.5, color=style.GREY
    )
    return figure


def shown(posterior: Mapping[str, Any]) -> tuple[list[str], Array]:
    """Names and draws (n, k) of the directions that the figure has room for."""
    draws = style.array(posterior.get("corner") or [])
    names = [str(name) for name in posterior.get("directions") or []]
    if draws.ndim != 2 or draws.shape[1] != len(names):
        return [], np.zeros((0, 0))
    return names[:MOST], draws[np.isfinite(draws).all(axis=1), :MOST]


def short(names: list[str]) -> list[str]:
    """Names as axis labels; long ones become d1, d2, ..., told in a table beside the
    figure.
    """
    fits = all(len(name) <= LONGEST_LABEL for name in names)
    return names if fits else [f"d{k}" for k in range(1, len(names) + 1)]


def _limits(x: Array) -> tuple[float, float]:
    """Room for the prior where the posterior is as wide; a close view where it is much
    narrower.
    """
    low, high = np.quantile(x, (0.001, 0.999))
    margin = 0.15 * (high - low) + 1e-12
    if np.std(x) < 0.3:
        return float(low - margin), float(high + margin)
    return min(-3.2, float(low - margin)), max(3.2, float(high + margin))


def _cell(
    axes: Axes, draws: Array, limits: list[tuple[float, float]], i: int, j: int
) -> None:
    if j > i:
        axes.set_visible(False)
        return
    axes.grid(False)
    if i == j:
        _diagonal(axes, draws[:, i], limits[i])
    else:
        _pair(axes, draws[:, j], draws[:, i], limits[j], limits[i])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    axes.tick_params(
        labelsize=6.5, labelbottom=i == len(limits) - 1, labelleft=j == 0 and i > 0
    )


def _diagonal(axes: Axes, x: Array, limits: tuple[float, float]) -> None:
    axes.hist(
        x,
        bins=36,
        range=limits,
        density=True,
        color=style.SKY,
        histtype="stepfilled",
        lw=0,
    )
    at = np.linspace(*limits, 120)
    axes.plot(
        at, np.exp(-(at**2) / 2.0) / np.sqrt(2.0 * np.pi), color=style.GREY, lw=1.1
    )
    axes.set_xlim(limits)
    axes.yaxis.set_visible(False)
    axes.spines["left"].set_visible(False)


def _pair(
    axes: Axes, x: Array, y: Array, xlim: tuple[float, float], ylim: tuple[float, float]
) -> None:
    counts, xs, ys = np.histogram2d(x, y, bins=34, range=(xlim, ylim))
    shaded = np.ma.masked_equal(counts.T, 0.0)
    axes.pcolormesh(
        xs, ys, shaded, cmap=style.AMOUNT, vmin=-0.1 * counts.max(), rasterized=True
    )
    if (
        max(xlim[0], ylim[0]) <= -1.0 and min(xlim[1], ylim[1]) >= 1.0
    ):  # an arc of it would only puzzle
        circle = np.linspace(0.0, 2.0 * np.pi, 90)
        axes.plot(np.cos(circle), np.sin(circle), color=style.GREY, lw=0.8, ls="--")
    axes.set_xlim(xlim)
    axes.set_ylim(ylim)


def _labels(grid: Any, names: list[str]) -> None:
    k = len(names)
    for i, label in enumerate(short(names)):
        grid[k - 1, i].set_xlabel(style.safe(label, LONGEST_LABEL), fontsize=7.5)
        if i > 0:
            grid[i, 0].set_ylabel(style.safe(label, LONGEST_LABEL), fontsize=7.5)
