"""Figures for notebooks: each function draws one section on a matplotlib axis.

The user's own style stays: only colours are those of the reports.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from oed.result import (
    DesignSection,
    EstimateSection,
    GapSection,
    ParameterEstimate,
    PlannedReading,
    PlanSection,
    PosteriorSection,
    PredictionSection,
)
from pkm_reports import missing, style, text

MAX_EFFECTS = 10  #: effects that the diagnosis' figure shows


def new_axes() -> Axes:
    """An axis of a new figure of pyplot, which a notebook shows."""
    from matplotlib import pyplot

    return pyplot.subplots()[1]


def design(section: DesignSection, axes: Axes) -> None:
    """The chosen readings over the two commands that vary most, by set-up, in order."""
    poses = section.poses
    names = _varying_commands(poses)
    if not names:
        raise ValueError("the design states no commands to draw its readings over")
    across, up = names[0], names[-1]
    for setup, colour in style.colours([pose.setup for pose in poses]).items():
        members = [pose.command for pose in poses if pose.setup == setup]
        places = missing.column(members, across), missing.column(members, up)
        axes.plot(*places, "-", color=colour, alpha=0.3, lw=0.8)
        axes.plot(*places, "o", color=colour, label=setup)
    axes.set_xlabel(text.heading(across))
    axes.set_ylabel(text.heading(up))
    axes.set_title(f"{section.n} readings in working order")
    axes.legend()


def _varying_commands(poses: Sequence[PlannedReading]) -> list[str]:
    """Up to two command columns, those with the most different values first."""
    names = list(dict.fromkeys(name for pose in poses for name in pose.command))
    commands = [pose.command for pose in poses]
    counts = {n: len(np.unique(missing.column(commands, n))) for n in names}
    return sorted(names, key=lambda name: -counts[name])[:2]


def residuals(section: EstimateSection, axes: Axes) -> None:
    """Residual of each reading after the fit, channel by channel, in its fine unit."""
    values = missing.array(section.residuals)
    channels = np.array(section.channels)
    for channel, colour in style.colours(section.channels).items():
        numbers = np.flatnonzero(channels == channel)
        unit = text.unit_symbol(section.units[channel])
        label = f"{channel} [{unit}]"
        axes.plot(numbers + 1, values[numbers], "o", color=colour, label=label)
    axes.axhline(0.0, color=style.GREY, lw=0.8)
    axes.set_xlabel("reading, in the order of the data")
    axes.set_ylabel("residual after the fit")
    axes.legend()


def posterior(
    section: PosteriorSection, parameters: Mapping[str, ParameterEstimate], axes: Axes
) -> None:
    """Mean and 95 % interval of each parameter, from nominal, in tolerances."""
    names = [name for name in section.marginals if name in parameters]
    shown = [name for name in names if parameters[name].prior_sd > 0.0]
    for k, name in enumerate(shown):
        marginal, parameter = section.marginals[name], parameters[name]
        ends = np.array([marginal.q025, marginal.mean, marginal.q975])
        low, middle, high = (ends - parameter.nominal) / parameter.prior_sd
        axes.plot([low, high], [k, k], color=style.BLUE)
        axes.plot([middle], [k], "o", color=style.BLUE)
    axes.axvspan(-1.0, 1.0, color=style.SHADE, zorder=0)
    axes.set_yticks(range(len(shown)), shown)
    axes.invert_yaxis()
    axes.set_xlabel("deviation from nominal [tolerances], 95 % interval")


def accuracy(section: PredictionSection, axes: Axes) -> None:
    """Rms error of each component before and after, on a log scale."""
    names = list(section.components)
    places = np.arange(len(names))
    components = section.components.values()
    series = (
        ("before", style.LIGHT, [c.before.rms for c in components]),
        ("after", style.BLUE, [c.after.rms for c in components]),
        ("unknown part", style.GREEN, [c.known.rms for c in components]),
    )
    for k, (label, colour, sizes) in enumerate(series):
        axes.bar(places + 0.27 * (k - 1), sizes, 0.25, color=colour, label=label)
    axes.set_yscale("log")
    titles = [f"{n}\n[{text.unit_symbol(section.unit[n])}]" for n in names]
    axes.set_xticks(places, titles)
    axes.set_ylabel("rms error over the workspace")
    axes.legend()


def stages(section: PlanSection, axes: Axes) -> None:
    """Rms error of each component stage by stage, as a share of what it is before."""
    if not section.start_accuracy:
        raise ValueError("the plan states no accuracy before its first stage")
    for k, key in enumerate(section.start_accuracy):
        start = section.start_accuracy[key]
        after = [missing.entry(stage.accuracy, key) for stage in section.stages]
        shares = np.array([start, *after]) / start
        colour = style.CYCLE[k % len(style.CYCLE)]
        axes.plot(shares, "o-", color=colour, label=text.split_unit(key)[0])
    axes.set_yscale("log")
    names = ["before", *[stage.measurement for stage in section.stages]]
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("rms error, share of that before")
    axes.legend()


def causes(section: GapSection, axes: Axes) -> None:
    """Probability of each effect that could be tested, the likeliest above."""
    finite = {n: p for n, p in section.marginal.items() if math.isfinite(p)}
    names = sorted(finite, key=lambda name: (-finite[name], name))[:MAX_EFFECTS]
    chosen = [name in section.selected for name in names]
    colours = [style.BLUE if selected else style.LIGHT for selected in chosen]
    axes.barh(range(len(names)), [finite[name] for name in names], color=colours)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("probability that the effect acts")
