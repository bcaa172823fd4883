"""Chapter: the posterior by sampling: worst directions, marginals, sampler diagnostics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.result import Marginal, PosteriorSection, PredictiveCheckRecord, StudyResult
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Notice,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    transposed,
)
from pkm_reports.missing import or_nan

# Posterior of the worst-determined directions: each alone, and all pairs.

Limits = tuple[float, float]
MAX_CORNER_PARAMETERS: Final = 6
MAX_LABEL_LENGTH: Final = 18
LABEL_WIDTH: Final = 0.55  #: inches to the left of all panels, for their labels
LABEL_HEIGHT: Final = 0.56  #: inches below all panels, for labels and unit
MARGIN: Final = 0.07  #: inches beside and above all panels, half a label of a tick
GAP: Final = 0.13  #: gap between panels, as a share of their size
#: sd below which a marginal is shown from close by, without the prior
CLOSE_VIEW_MAX_RATIO: Final = 0.3
PRIOR_RANGE: Final = 3.2  #: prior standard deviations that hold the prior


def draw_corner(posterior: PosteriorSection) -> style.Figure:
    """Draws of each pair below the diagonal, histograms and the prior N(0, 1) on it."""
    names, draws = corner_parameters(posterior)
    if not len(draws) or not names:
        return style.empty("No draws of the posterior are stored in this result.")
    n = len(names)
    width = min(style.FIGURE_WIDTH, 0.8 + 1.25 * n) if n > 1 else 3.2
    height = 0.6 + 1.15 * n
    figure = style.placed_figure(height, width=width)
    edges: Any = {"left": LABEL_WIDTH / width, "right": 1.0 - MARGIN / width}
    edges |= {"bottom": LABEL_HEIGHT / height, "top": 1.0 - MARGIN / height}
    grid = figure.add_gridspec(n, n, **edges, wspace=GAP, hspace=GAP)
    limits = [_limits(draws[:, i]) for i in range(n)]
    labels = [style.label(name, MAX_LABEL_LENGTH) for name in short_names(names)]
    for i in range(n):
        for j in range(i + 1):
            axes = figure.add_subplot(grid[i, j])
            _cell(axes, draws, limits, i, j)
            if i == n - 1:
                axes.set_xlabel(labels[j], fontsize=7.5)
            if j == 0 and i > 0:
                axes.set_ylabel(labels[i], fontsize=7.5)
    axis_label = "prior standard deviations (tolerances)"
    figure.supxlabel(axis_label, fontsize=7.5, color=style.GREY)
    return figure


def corner_parameters(posterior: PosteriorSection) -> tuple[list[str], Array]:
    """Names and draws (n, k) of the directions that the figure has room for."""
    draws = missing.table(posterior.corner)
    names = posterior.directions
    if draws.shape[1] != len(names):
        return [], np.zeros((0, 0))
    return names[:MAX_CORNER_PARAMETERS], draws[
        np.isfinite(draws).all(axis=1), :MAX_CORNER_PARAMETERS
    ]


def short_names(names: Sequence[str]) -> list[str]:
    """Names as axis labels; long ones become d1, d2, ..., explained in a table."""
    if all(len(name) <= MAX_LABEL_LENGTH for name in names):
        return list(names)
    return [f"d{k}" for k in range(1, len(names) + 1)]


def _limits(x: Array) -> Limits:
    """Room for the prior, unless the posterior is much narrower."""
    low, high = np.quantile(x, (0.001, 0.999))
    margin = 0.15 * (high - low) + 1e-12
    lower, upper = float(low - margin), float(high + margin)
    if np.std(x) < CLOSE_VIEW_MAX_RATIO:
        return lower, upper
    return min(-PRIOR_RANGE, lower), max(PRIOR_RANGE, upper)


def _cell(
    axes: style.Axes, draws: Array, limits: Sequence[Limits], i: int, j: int
) -> None:
    axes.grid(False)
    if i == j:
        _histogram(axes, draws[:, i], limits[i])
    else:
        _pair(axes, draws[:, j], draws[:, i], limits[j], limits[i])
    for axis in (axes.xaxis, axes.yaxis):
        style.few_ticks(axis, 3, steps=[1, 2, 5, 10])
    outer: Any = {"labelbottom": i == len(limits) - 1, "labelleft": j == 0 and i > 0}
    axes.tick_params(labelsize=6.5, **outer)


def _histogram(axes: style.Axes, x: Array, limits: Limits) -> None:
    look: Any = {"color": style.SKY, "histtype": "stepfilled", "lw": 0}
    axes.hist(x, bins=36, range=limits, density=True, **look)
    grid = np.linspace(*limits, 120)
    prior = np.exp(-(grid**2) / 2.0) / np.sqrt(2.0 * np.pi)
    axes.plot(grid, prior, color=style.GREY, lw=1.1)
    axes.set_xlim(limits)
    axes.yaxis.set_visible(False)
    axes.spines["left"].set_visible(False)


def _pair(axes: style.Axes, x: Array, y: Array, xlim: Limits, ylim: Limits) -> None:
    counts, _, _ = np.histogram2d(x, y, bins=34, range=(xlim, ylim))
    density = np.ma.masked_equal(counts.T, 0.0)
    shade: Any = {"cmap": style.AMOUNT, "vmin": -0.1 * counts.max()}
    cells: Any = {"extent": (*xlim, *ylim), "origin": "lower", "aspect": "auto"}
    axes.imshow(density, interpolation="nearest", **cells, **shade)
    # An arc of the prior's circle would only puzzle: it is drawn where all of it fits.
    lower, upper = max(xlim[0], ylim[0]), min(xlim[1], ylim[1])
    if lower <= -1.0 and upper >= 1.0:
        angle = np.linspace(0.0, 2.0 * np.pi, 90)
        line: Any = {"color": style.GREY, "lw": 0.8, "ls": "--"}
        axes.plot(np.cos(angle), np.sin(angle), **line)
    axes.set_xlim(xlim)
    axes.set_ylim(ylim)


MAX_RHAT: Final = 1.01
MIN_ESS: Final = 1000.0
#: sd, in prior standard deviations, above which the readings say little
MAX_INFORMED_RATIO: Final = 0.7
#: standard errors of mean, sd, and both quantiles of a normal marginal, over its sd and
#: times the root of the effective sample size
ERRORS: Final = (1.0, 0.5**0.5, 2.67, 2.67)
ESS_RELATIVE_ERROR: Final = 0.05  #: relative error of an effective sample size
COMPARED: Final = {
    "rms": "Root mean square",
    "largest": "Largest",
    "neighbours": "Correlation of neighbours",
    "run_means": "Means of the runs, rms",
}


def blocks(result: StudyResult) -> list[Block]:
    """Sampler, marginals, corner plot, directions, checks."""
    posterior = result.posterior
    if posterior is None:
        return []
    caption = _caption(posterior)
    # The long table breaks over pages; after it, the tall picture leaves no gap.
    return [
        Paragraph(_sampler(posterior)),
        *_diagnostics(posterior.marginals),
        *_marginals(posterior.marginals),
        Picture("corner", lambda: draw_corner(posterior), caption),
        *_directions(posterior),
        *_checks(posterior.checks),
    ]


def _sampler(posterior: PosteriorSection) -> str:
    draws, points = text.number(posterior.draws), text.number(posterior.proposals)
    refused = ""
    if posterior.pareto_k is not None:
        limit = text.fixed(PosteriorSection.largest_pareto_k(posterior.proposals), 2)
        k = text.fixed(posterior.pareto_k, 2)
        if posterior.sampler == PosteriorSection.IMPORTANCE:
            return (
                f"The posterior has {draws} draws: {points} independent points about the"
                " estimate were weighted by the density, and draws taken by weight. The"
                f" tail of the weights has Pareto k = {k}; up to {limit} such draws are"
                " reliable. All draws are in posterior.nc."
            )
        refused = (
            f" Draws by weight were no use: of {points} points about the estimate the"
            f" weights have Pareto k = {k} (reliable up to {limit}), or few count."
        )
    walkers = text.count(posterior.walkers, "walker")
    acceptance = text.percent(posterior.acceptance)
    time = text.number(posterior.autocorrelation)
    return (
        f"The posterior has {draws} draws from {walkers} in independent ensembles, which"
        " R-hat compares. The sampler accepted"
        f" {acceptance} of its moves; the autocorrelation time is {time} steps.{refused}"
        " All draws are in posterior.nc."
    )


def _diagnostics(marginals: Mapping[str, Marginal]) -> list[Block]:
    """A notice where a marginal is badly sampled, a sentence where all are well."""
    sampled = {name: m for name, m in marginals.items() if math.isfinite(or_nan(m.ess))}
    if not sampled:
        return []
    rhat = max((m.rhat for m in sampled.values() if m.rhat is not None), default=None)
    ess = min(or_nan(m.ess) for m in sampled.values())
    diagnostics = f"the effective sample size is at least {_sample_size(ess)}"
    if rhat is not None:
        diagnostics = (
            f"R-hat is at most {text.fixed(rhat, 3)}, and the effective sample size at"
            f" least {_sample_size(ess)}"
        )
    bad = [name for name, m in sampled.items() if not _is_well_sampled(m)]
    if not bad:
        return [Paragraph(f"Every marginal is well sampled: {diagnostics}.")]
    wanted, what = f"{MIN_ESS:.0f} at least", "The draws are few"
    if rhat is not None:
        wanted = f"{MAX_RHAT} at most, {wanted}"
        what = "The sampler has not fully mixed"
    return [
        Notice(
            f"{what}: {diagnostics} (wanted: {wanted}). This concerns"
            f" {text.listing(bad, 8)}."
        )
    ]


def _is_well_sampled(marginal: Marginal) -> bool:
    mixed = marginal.rhat is None or or_nan(marginal.rhat) <= MAX_RHAT
    return mixed and or_nan(marginal.ess) >= MIN_ESS


def _caption(posterior: PosteriorSection) -> str:
    names, draws = corner_parameters(posterior)
    caption = (
        "Posterior of the worst-determined directions in prior standard deviations:"
        " below the diagonal the draws of each pair (dashed, where it fits: the prior's"
        " 1-sigma circle), on it the histogram, with the prior in grey."
    )
    if not names:
        return caption
    sds = np.std(draws, axis=0)
    labels = short_names(names)
    sizes = [
        f"{label} {text.number(sd, 2)}" for label, sd in zip(labels, sds, strict=True)
    ]
    uncertain = int(np.sum(sds > MAX_INFORMED_RATIO))
    verdict = (
        f"{uncertain} of {len(names)} stay nearly as wide as the prior: the readings say"
        " little about them."
        if uncertain
        else "The readings clearly tighten all of them."
    )
    return f"{caption} Standard deviations: {text.listing(sizes)}. {verdict}"


def _directions(posterior: PosteriorSection) -> list[Block]:
    """What d1, d2, ... stand for, where the names are too long for the axes."""
    names, draws = corner_parameters(posterior)
    labels = short_names(names)
    if not names or labels == names:
        return []
    columns = [
        TableColumn("Label"),
        TableColumn("Direction", wide=True),
        *TableColumn.numbers("Mean", "sd"),
    ]
    means = [text.fixed(x, 2) for x in np.mean(draws, axis=0)]
    sds = [text.fixed(x, 2) for x in np.std(draws, axis=0)]
    rows = transposed([labels, names, means, sds])
    caption = (
        "Directions of the corner plot, in prior standard deviations (an sd of 1 means"
        " that the readings say nothing)."
    )
    return [Table(columns, rows, caption)]


def _marginals(marginals: Mapping[str, Marginal]) -> list[Block]:
    if not marginals:
        return []
    columns = [
        TableColumn("Parameter"),
        *TableColumn.numbers("Mean", "sd", "2.5 %", "97.5 %"),
        TableColumn("Unit"),
    ]
    # independent draws have no R-hat
    mixed = any(m.rhat is not None for m in marginals.values())
    columns += (
        TableColumn.numbers("R-hat", "ESS") if mixed else TableColumn.numbers("ESS")
    )
    rows = [_marginal_row(name, m, mixed) for name, m in marginals.items()]
    caption = (
        "Marginals of the posterior with sampler diagnostics (ESS: effective sample"
        " size, which decides how many digits are printed)."
    )
    return [Table(columns, rows, caption)]


def _checks(checks: Mapping[str, PredictiveCheckRecord]) -> list[Block]:
    """Residuals against those that the posterior predicts."""
    if not checks:
        return []
    columns = [
        TableColumn("Of the residuals"),
        *TableColumn.numbers("Observed", "2.5 %", "97.5 %", "Probability of more"),
    ]
    rows = [
        [
            text.meaning(name, COMPARED),
            text.number(check.observed, 2),
            text.number(check.low, 2),
            text.number(check.high, 2),
            text.number(check.p_high, 2),
        ]
        for name, check in checks.items()
    ]
    caption = (
        "Posterior predictive checks, in units of the stated noise. A probability near 0"
        " or 1 says that the readings contradict the posterior."
    )
    return [Table(columns, rows, caption)]


def _marginal_row(name: str, marginal: Marginal, mixed: bool) -> list[str]:
    numbers = (marginal.mean, marginal.sd, marginal.q025, marginal.q975)
    return [
        name,
        *[
            text.fixed(number, _decimals(marginal, error))
            for number, error in zip(numbers, ERRORS, strict=True)
        ],
        text.unit_symbol(marginal.unit),
        *([text.fixed(marginal.rhat, 3)] if mixed else []),
        _sample_size(marginal.ess),
    ]


def _sample_size(ess: float | None) -> str:
    """An effective sample size: an estimate that is right to some per cent."""
    return text.drawn(ess, ESS_RELATIVE_ERROR * or_nan(ess))


def _decimals(marginal: Marginal, error: float) -> int:
    """Decimals of a figure whose standard error for one draw is `error` times the sd."""
    usual, ess = text.decimals_for(marginal.sd), or_nan(marginal.ess)
    if not ess > 0.0 or marginal.sd <= 0.0:
        return usual
    size = error * marginal.sd / math.sqrt(ess)
    return max(0, min(usual, -text.last_place(size)))


CHAPTER: Final = Chapter("posterior", "Posterior", blocks)
