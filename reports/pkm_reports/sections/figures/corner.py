"""Posterior of the worst-determined directions: each alone, and all pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from oed.base import Array
from oed.result import PosteriorSection
from pkm_reports import missing, style

Limits = tuple[float, float]
MOST: Final = 6
LONGEST_LABEL: Final = 18
#: sd below which a marginal is shown from close by, without the prior
NARROW: Final = 0.3
#: prior standard deviations that hold the prior
PRIOR_RANGE: Final = 3.2


def draw(posterior: PosteriorSection) -> Figure:
    """Below the diagonal the draws of each pair, on it the histogram of each.

    The prior N(0, 1) is drawn in grey.
    """
    names, draws = shown(posterior)
    if not len(draws) or not names:
        return style.empty("No draws of the posterior are stored in this result.")
    n = len(names)
    width = min(style.WIDTH, 0.8 + 1.25 * n) if n > 1 else 3.2
    figure = style.figure(0.6 + 1.15 * n, width=width)
    grid = figure.subplots(n, n, squeeze=False)
    limits = [_limits(draws[:, i]) for i in range(n)]
    for i in range(n):
        for j in range(n):
            _cell(grid[i, j], draws, limits, i, j)
    _set_labels(grid, names)
    axis_label = "prior standard deviations (tolerances)"
    figure.supxlabel(axis_label, fontsize=7.5, color=style.GREY)
    return figure


def shown(posterior: PosteriorSection) -> tuple[list[str], Array]:
    """Names and draws (n, k) of the directions that the figure has room for."""
    draws = missing.table(posterior.corner)
    names = posterior.directions
    if draws.shape[1] != len(names):
        return [], np.zeros((0, 0))
    return names[:MOST], draws[np.isfinite(draws).all(axis=1), :MOST]


def short_names(names: Sequence[str]) -> list[str]:
    """Names as axis labels; long ones become d1, d2, ..., explained in a table."""
    if all(len(name) <= LONGEST_LABEL for name in names):
        return list(names)
    return [f"d{k}" for k in range(1, len(names) + 1)]


def _limits(x: Array) -> Limits:
    """Room for the prior, unless the posterior is much narrower."""
    low, high = np.quantile(x, (0.001, 0.999))
    margin = 0.15 * (high - low) + 1e-12
    lower, upper = float(low - margin), float(high + margin)
    if np.std(x) < NARROW:
        return lower, upper
    return min(-PRIOR_RANGE, lower), max(PRIOR_RANGE, upper)


def _cell(
    axes: Axes,
    draws: Array,
    limits: Sequence[Limits],
    i: int,
    j: int,
) -> None:
    if j > i:
        axes.set_visible(False)
        return
    axes.grid(False)
    if i == j:
        _histogram(axes, draws[:, i], limits[i])
    else:
        _pair(axes, draws[:, j], draws[:, i], limits[j], limits[i])
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    axes.tick_params(labelsize=6.5)
    axes.tick_params(labelbottom=i == len(limits) - 1)
    axes.tick_params(labelleft=j == 0 and i > 0)


def _histogram(axes: Axes, x: Array, limits: Limits) -> None:
    look: Any = {"color": style.SKY, "histtype": "stepfilled", "lw": 0}
    axes.hist(
        x,
        bins=36,
        range=limits,
        density=True,
        **look,
    )
    grid = np.linspace(*limits, 120)
    prior = np.exp(-(grid**2) / 2.0) / np.sqrt(2.0 * np.pi)
    axes.plot(grid, prior, color=style.GREY, lw=1.1)
    axes.set_xlim(limits)
    axes.yaxis.set_visible(False)
    axes.spines["left"].set_visible(False)


def _pair(
    axes: Axes,
    x: Array,
    y: Array,
    xlim: Limits,
    ylim: Limits,
) -> None:
    counts, xs, ys = np.histogram2d(
        x,
        y,
        bins=34,
        range=(xlim, ylim),
    )
    density = np.ma.masked_equal(counts.T, 0.0)
    shade: Any = {"cmap": style.AMOUNT, "vmin": -0.1 * counts.max()}
    axes.pcolormesh(xs, ys, density, rasterized=True, **shade)
    # An arc of the prior's circle would only puzzle: it is drawn where all of it fits.
    lower, upper = max(xlim[0], ylim[0]), min(xlim[1], ylim[1])
    if lower <= -1.0 and upper >= 1.0:
        angle = np.linspace(0.0, 2.0 * np.pi, 90)
        line: Any = {"color": style.GREY, "lw": 0.8, "ls": "--"}
        axes.plot(np.cos(angle), np.sin(angle), **line)
    axes.set_xlim(xlim)
    axes.set_ylim(ylim)


def _set_labels(grid: Any, names: Sequence[str]) -> None:
    last = len(names) - 1
    for i, name in enumerate(short_names(names)):
        label = style.label(name, LONGEST_LABEL)
        grid[last, i].set_xlabel(label, fontsize=7.5)
        if i > 0:
            grid[i, 0].set_ylabel(label, fontsize=7.5)
