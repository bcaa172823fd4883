"""Chapter: the accuracy before and after, by component and over the workspace."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from oed.base import Array, Mask
from oed.result import (
    BudgetSection,
    ComponentAccuracy,
    MapPoint,
    PredictionSection,
    SpreadRecord,
    StudyResult,
    UnmodelledLine,
)
from pkm_reports import missing, style, text
from pkm_reports.blocks import Block, Chapter, Paragraph, Picture, Table, TableColumn

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

# Which commands of a pose are the axes of a map, and which one makes its panels.

POLAR: Final = ("psi_deg", "theta_deg")
MAX_LEVELS: Final = 4
#: levels from which a command is not a stack of layers but a cloud
MIN_CLOUD_LEVELS: Final = 8


@dataclasses.dataclass(frozen=True, slots=True)
class MapLayout:
    """The commands that a map shows.

    across, up    names of the axes
    panel         command with a panel for each of its levels, None for a single panel
    levels        values of that command
    """

    across: str
    up: str
    panel: str | None
    levels: list[float]

    @property
    def polar(self) -> bool:
        """Whether the angle is the azimuth of the tilt and the radius the tilt."""
        return (self.across, self.up) == POLAR

    def poses_at(self, level: float, commands: Mapping[str, Array]) -> Mask:
        """Which poses (n,) belong to a panel."""
        if self.panel is None:
            return np.ones(len(commands[self.across]), dtype=bool)
        return np.asarray(commands[self.panel] == level)


def choose_layout(commands: Mapping[str, Array]) -> MapLayout:
    """Polar axes for psi and theta; otherwise the first two commands that vary."""
    varying = [name for name, values in commands.items() if np.ptp(values) > 0]
    constant = [name for name in commands if name not in varying]
    ordered = [*varying, *constant]
    across, up = POLAR if set(POLAR) <= set(commands) else ordered[:2]
    others = [name for name in ordered if name not in (across, up)]
    if not others:
        return MapLayout(across, up, None, [np.nan])
    levels = np.unique(commands[others[0]])
    if len(levels) > MIN_CLOUD_LEVELS:
        return MapLayout(across, up, None, [np.nan])
    spaced = np.linspace(0, len(levels) - 1, min(MAX_LEVELS, len(levels)))
    picked = np.unique(spaced.round().astype(int))
    return MapLayout(across, up, others[0], levels[picked].tolist())


# Error after compensation over the workspace, as a map for each component.

MAX_ROWS: Final = 3
COMMAND_DECIMALS: Final = 9  #: decimals to which commands are compared
#: share of a grid's cells from which the poses count as a grid
MIN_GRID_SHARE: Final = 0.4
#: factor between the errors from which colours are logarithmic
LOG_COLOUR_MIN_RANGE: Final = 6.0
#: angle, direction and alignment of the labels around a polar map
QUARTERS: Final = (
    ("0°", (1.05, 0.0), "left", "center"),
    ("90°", (0.0, 1.05), "center", "bottom"),
    ("180°", (-1.05, 0.0), "right", "center"),
    ("270°", (0.0, -1.05), "center", "top"),
)
#: points between a polar map and its title, which has a label in between
POLAR_PAD: Final = 13.0


def draw_workspace(prediction: PredictionSection) -> Figure:
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
    grid = figure.subplots(rows, columns, squeeze=False)
    grid = grid.reshape(len(names), panels)
    for k, (row, name) in enumerate(zip(grid, names, strict=True)):
        _component_row(figure, row, layout, commands, name, prediction)
        for axes, level in zip(row, layout.levels, strict=True):
            title = _level_title(layout, level) if k == 0 or panels == 1 else ""
            letters: Any = {"fontsize": 7.5, "fontweight": "normal"}
            pad = POLAR_PAD if layout.polar else None
            axes.set_title(title, loc="center", pad=pad, **letters)
    return figure


def shown_components(prediction: PredictionSection) -> list[str]:
    """Up to three components, those that the controller can correct if there are any."""
    components = prediction.components
    correctable = [name for name, c in components.items() if c.compensatable]
    return (correctable or list(components))[:MAX_ROWS]


def component_errors(prediction: PredictionSection, name: str) -> Array:
    """Error of a component after compensation at each pose of the map (n,)."""
    return missing.column([point.after for point in prediction.map], name)


def _component_row(
    figure: Figure,
    row: Any,
    layout: MapLayout,
    commands: Mapping[str, Array],
    name: str,
    prediction: PredictionSection,
) -> None:
    """The panels of one component and their colour bar."""
    from matplotlib.colors import LogNorm

    values = component_errors(prediction, name)
    norm = _norm(values)
    for axes, level in zip(row, layout.levels, strict=True):
        at_level = layout.poses_at(level, commands)
        across = commands[layout.across][at_level]
        up = commands[layout.up][at_level]
        image = _map_panel(axes, across, up, values[at_level], layout, norm)
    single = len(row) == 1
    options: Any = {"location": "bottom" if single else "right"}
    options["pad"] = 0.03 if single else 0.02
    unit = text.unit_symbol(prediction.components[name].after.unit)
    label = style.label(f"error of {name} [{unit}]")
    bar: Any = figure.colorbar(image, ax=list(row), shrink=0.85, label=label, **options)
    bar.outline.set_visible(False)
    along = "x" if single else "y"
    if isinstance(norm, LogNorm):
        style.log_axis(bar.ax, along)
    else:
        style.few_ticks(getattr(bar.ax, f"{along}axis"), 5)


def _level_title(layout: MapLayout, level: float) -> str:
    if layout.panel is None:
        return "all poses"
    stem, unit = text.split_unit(layout.panel)
    return style.label(f"{stem} = {text.number(level, 4)} {text.unit_symbol(unit)}")


def _norm(values: Array) -> Normalize:
    """Linear colours, or logarithmic ones where a few poses would outshine the others."""
    from matplotlib.colors import LogNorm, Normalize

    low = float(np.nanmin(values, initial=np.inf))
    high = float(np.nanmax(values, initial=-np.inf))
    if not np.isfinite(low):
        return Normalize(0.0, 1.0)
    if low > 0.0 and high > LOG_COLOUR_MIN_RANGE * low:
        return LogNorm(low, high)
    return Normalize(min(low, 0.8 * high), high if high > low else low + 1.0)


def _map_panel(
    axes: Any,
    across: Array,
    up: Array,
    values: Array,
    layout: MapLayout,
    norm: Normalize,
) -> Any:
    cells = _cells(across, up, values)
    shade: Any = {"cmap": style.AMOUNT, "norm": norm}
    places = (across, up) if cells is None else np.meshgrid(*cells[:2])
    if layout.polar:
        # axes of a rectangle take a third of the time of matplotlib's polar ones
        angle, radius = np.radians(places[0]), np.maximum(places[1], 0.0)
        places = radius * np.cos(angle), radius * np.sin(angle)
    if cells is None:
        marks: Any = {"s": 26, "ec": style.GREY, "lw": 0.3}
        image = axes.scatter(*places, c=values, **shade, **marks)
    else:
        image = axes.pcolormesh(*places, cells[2], rasterized=True, **shade)
    if layout.polar:
        _set_polar_axes(axes, up)
    else:
        _set_cartesian_axes(axes, layout)
    return image


def _cells(
    across: Array, up: Array, values: Array
) -> tuple[Array, Array, Array] | None:
    """Cell edges and a grid of values with gaps as NaN; None where there is no grid."""
    across, up = across.round(COMMAND_DECIMALS), up.round(COMMAND_DECIMALS)
    xs, ys = np.unique(across), np.unique(up)
    cells = len(xs) * len(ys)
    if min(len(xs), len(ys)) < 2 or len(values) < MIN_GRID_SHARE * cells:
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
    outer = float(_edges(tilts)[-1] if len(tilts) > 1 else 1.1 * tilts[-1])
    axes.set_axis_off()
    axes.set(xlim=(-outer, outer), ylim=(-outer, outer), aspect="equal")
    for angle, (x, y), ha, va in QUARTERS:
        axes.text(outer * x, outer * y, angle, fontsize=6, ha=ha, va=va)


def _set_cartesian_axes(axes: Axes, layout: MapLayout) -> None:
    axes.grid(False)
    if text.split_unit(layout.across)[1] == text.split_unit(layout.up)[1]:
        axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel=text.heading(layout.across), ylabel=text.heading(layout.up))
    style.few_ticks(axes.xaxis, 4)
    style.few_ticks(axes.yaxis, 4)


def _line_over_command(
    prediction: PredictionSection, commands: Mapping[str, Array], names: Sequence[str]
) -> Figure:
    ((command, values),) = commands.items()
    figure = style.figure(2.4)
    axes = figure.subplots()
    order = np.argsort(values)
    for name in names:
        unit = text.unit_symbol(prediction.components[name].after.unit)
        label = style.label(f"{name} [{unit}]")
        axes.plot(
            values[order], component_errors(prediction, name)[order], "o-", label=label
        )
    axes.set(xlabel=text.heading(command), ylabel="error after compensation")
    axes.legend()
    return figure


# Sources of the uncertainty that remains, as shares of each component's variance.

MIN_WRITTEN_SHARE: Final = 7.0  #: percent from which a share is written into its bar
#: characters of all names together from which the legend has fewer columns
MAX_LEGEND_CHARACTERS: Final = 60


def draw_budget(components: Mapping[str, ComponentAccuracy]) -> Figure:
    """One stacked bar for each component."""
    budgets = [component.budget for component in components.values()]
    sources = list(dict.fromkeys(name for budget in budgets for name in budget))
    if not sources:
        return style.empty("No uncertainty budget is stored in this result.")
    legend_rows = np.ceil(len(sources) / 4)
    figure = style.figure(0.95 + 0.26 * len(components) + 0.16 * legend_rows)
    axes = figure.subplots()
    start = np.zeros(len(budgets))
    for k, source in enumerate(sources):
        percent = np.nan_to_num(100.0 * missing.column(budgets, source))
        _stack(axes, k, source, start, percent)
        start = start + percent
    style.fixed_ticks(axes, "y", range(len(components)), list(components))
    axes.set_xlim(0.0, max(100.0, start.max()))
    axes.set_xlabel("share of the variance that remains [%]")
    axes.set_ylim(len(components) - 0.5, -0.5)
    axes.grid(False)
    few = sum(map(len, sources)) < MAX_LEGEND_CHARACTERS
    figure.legend(loc="outside lower center", ncols=5 if few else 4)
    return figure


def _stack(axes: Axes, k: int, source: str, start: Array, percent: Array) -> None:
    """The k-th source beside those before it, hatched where the colours repeat."""
    colour = style.CYCLE[k % len(style.CYCLE)]
    look: Any = {
        "height": 0.7,
        "color": colour,
        "hatch": "///" if k >= len(style.CYCLE) else None,
        "ec": "white",
        "label": style.label(source),
    }
    bars = axes.barh(range(len(percent)), percent, left=start, **look)
    written = [
        f"{share:.0f}" if share >= MIN_WRITTEN_SHARE else "" for share in percent
    ]
    letters: Any = {"fontsize": 7, "fontweight": "bold"}
    letters["color"] = style.INK if colour in style.PALE else "white"
    axes.bar_label(bars, written, label_type="center", **letters)


# Residual accuracy of each pose component before and after calibration, as bars.
#
# Lengths and angles have panels of their own, each on a log scale.

State = Literal["before", "after", "known"]
#: what each bar of a component shows: attribute, label, colour
Bar = tuple[State, str, str]
BARS: Final[tuple[Bar, ...]] = (
    ("before", "before", style.LIGHT),
    ("after", "after correction by the controller", style.BLUE),
    ("known", "with additional axes", style.GREEN),
)
REALISED: Final = "realised, virtual machine"
BAR_WIDTH = 0.25  #: width of a bar, components
BAR_STEP = 0.27  #: distance between the bars of a component


def draw_components(prediction: PredictionSection) -> Figure:
    """Bars of the rms over the workspace, with a diamond for the virtual machine."""
    components = prediction.components
    if not components:
        return style.empty("No predicted accuracy is stored in this result.")
    units = list(dict.fromkeys(c.after.unit for c in components.values()))
    groups = [
        {name: c for name, c in components.items() if c.after.unit == unit}
        for unit in units
    ]
    bars = BARS[:2] if all_correctable(components) else BARS
    figure = style.figure(2.8)
    widths = [len(group) for group in groups]
    grid = figure.subplots(1, len(units), squeeze=False, width_ratios=widths)
    for axes, unit, group in zip(grid[0], units, groups, strict=True):
        _panel(axes, group, bars, prediction.realised or {})
        axes.set_ylabel(f"rms error [{text.unit_symbol(unit)}]")
    entries = style.legend_entries(grid[0][:1])
    labels = [label for _, label, _ in bars] + [REALISED]
    ordered = {label: entries[label] for label in labels if label in entries}
    style.legend_below(figure, ordered, len(ordered))
    return figure


def all_correctable(components: Mapping[str, ComponentAccuracy]) -> bool:
    """Whether the controller corrects all components, so that `known` adds nothing."""
    return all(c.known.rms == c.after.rms for c in components.values())


def _panel(
    axes: Axes,
    group: Mapping[str, ComponentAccuracy],
    bars: Sequence[Bar],
    realised: Mapping[str, SpreadRecord],
) -> None:
    places = np.arange(len(group))
    for k, (state, label, colour) in enumerate(bars):
        sizes = [spread_of(component, state).rms for component in group.values()]
        heights = np.array(sizes)
        shift = BAR_STEP * (k - (len(bars) - 1) / 2.0)
        positive = np.where(heights > 0.0, heights, np.nan)
        axes.bar(places + shift, positive, BAR_WIDTH, color=colour, label=label)
    shown = np.array(
        [realised[name].rms if name in realised else np.nan for name in group]
    )
    if np.isfinite(shown).any():
        axes.plot(places, shown, "D", label=REALISED, **style.DIAMOND)
    style.log_axis(axes, "y")
    _set_limits(axes, group, shown)
    labels = [name if c.compensatable else f"{name} *" for name, c in group.items()]
    style.fixed_ticks(axes, "x", places.tolist(), labels)
    axes.grid(False, axis="x")


def spread_of(component: ComponentAccuracy, state: State) -> SpreadRecord:
    """Errors of a component in one state."""
    spread: SpreadRecord = getattr(component, state)
    return spread


def _set_limits(
    axes: Axes, group: Mapping[str, ComponentAccuracy], realised: Array
) -> None:
    """From a third of the smallest to twice the largest, so that no bar vanishes."""
    heights = [spread_of(c, state).rms for c in group.values() for state, _, _ in BARS]
    sizes = np.array([*heights, *realised])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if sizes.size:
        axes.set_ylim(sizes.min() / 3.0, 2.0 * sizes.max())
        style.log_axis(axes, "y")


Components = Mapping[str, ComponentAccuracy]
REFERENCES: Final = {
    "absolute": "absolute: position and orientation in the base frame",
    "home": "relative to home: the machine is zeroed at its home pose",
    "best_fit": "after the best rigid fit: the workpiece is aligned to the machine",
}
MODES: Final = {
    "plan": "predicted before any reading is taken, from tolerances, plan and noise",
    "identified": "predicted with the identified parameters",
}


def blocks(result: StudyResult) -> list[Block]:
    """Bars, table, virtual machine, budget, map."""
    prediction = result.prediction
    if prediction is None:
        return []
    components = prediction.components
    chapter: list[Block] = [
        Paragraph(_introduction(prediction)),
        Paragraph(_verdict(components)),
        Picture(
            "accuracy", lambda: draw_components(prediction), _bars_caption(components)
        ),
        _table(components),
        *range_blocks(prediction),
    ]
    if prediction.realised:
        chapter.append(_realised(prediction, prediction.realised))
    if any(component.budget for component in components.values()):
        caption = _budget_caption(components)
        chapter.append(Picture("budget", lambda: draw_budget(components), caption))
    if prediction.budget is not None:
        chapter += budget_blocks(prediction.budget, components)
    if prediction.map:
        caption = _map_caption(prediction)
        chapter.append(
            Picture("workspace", lambda: draw_workspace(prediction), caption)
        )
    return chapter


def printed(result: StudyResult) -> list[Block]:
    """The bars."""
    prediction = result.prediction
    if prediction is None:
        return []
    caption = _bars_caption(prediction.components)
    if prediction.budget is not None and prediction.budget.unmodelled:
        caption += " Geometry alone; the first page counts usual effects as well."
    return [Picture("accuracy", lambda: draw_components(prediction), caption)]


# -- what the controller can correct ---------------------------------------------------
def _introduction(prediction: PredictionSection) -> str:
    reference = text.meaning(prediction.reference, REFERENCES)
    mode = text.meaning(prediction.mode, MODES)
    poses = text.count(prediction.poses, "workspace pose")
    return (
        f"Errors of the pose over {poses}, {mode}. Reference: {reference}. Numbers are"
        f" 1-sigma errors, pooled over the workspace.{_states(prediction)}"
    )


def _states(prediction: PredictionSection) -> str:
    """At which states effects act, and where these come from."""
    if not prediction.states:
        return ""
    source = "as the study states"
    if prediction.states_from == "readings":
        source = "as the readings recorded, for the study states none"
    parts = [
        f"{column} {', '.join(f'{value:g}' for value in values)}"
        for column, values in prediction.states.items()
    ]
    return f" The machine is used at {'; '.join(parts)}: {source}."


def _verdict(components: Components) -> str:
    """What the controller can correct, by how much, and what it cannot."""
    corrected, others = [], []
    for name, component in components.items():
        if component.compensatable:
            corrected.append(_improvement(name, component))
        else:
            others.append(_remainder(name, component))
    if corrected:
        sentences = [f"The controller can correct {text.listing(corrected)}."]
    else:
        sentences = ["The controller can correct none of them."]
    if others:
        sentences += [
            f"No axis corrects the others alone: {text.listing(others)}.",
            "An additional axis could correct them, or software that uses the known error.",
        ]
    return " ".join(sentences)


def _improvement(name: str, component: ComponentAccuracy) -> str:
    unit = component.after.unit
    before = text.quantity(component.before.rms, unit)
    after = text.quantity(component.after.rms, unit)
    if before == after:
        return f"{name}, which stays at {after}"
    return f"{name} from {before} to {after}"


def _remainder(name: str, component: ComponentAccuracy) -> str:
    unit = component.after.unit
    after = text.quantity(component.after.rms, unit)
    remaining = text.quantity(component.known.rms, unit)
    return f"{name} stays at {after} (known to {remaining})"


def _bars_caption(components: Components) -> str:
    caption = (
        "Rms error of each component over the workspace, before and after, on a log"
        " scale."
    )
    if not all(component.compensatable for component in components.values()):
        caption += " A star marks components that the controller cannot correct."
    gains = {
        name: component.before.rms / component.after.rms
        for name, component in components.items()
        if component.compensatable and component.after.rms > 0.0
    }
    if not gains:
        return caption
    best = max(gains, key=lambda name: gains[name])
    worst = min(gains, key=lambda name: gains[name])
    high, low = text.number(gains[best], 2), text.number(gains[worst], 2)
    caption += f" Calibration divides the error of {best} by {high}"
    return f"{caption}." if high == low else f"{caption} and of {worst} by {low}."


def _table(components: Components) -> Table:
    states: Sequence[State] = ("before", "after", "known")
    if all_correctable(components):
        states = states[:2]
    columns = [TableColumn("Component"), TableColumn("Correctable")]
    for state in states:
        columns += TableColumn.numbers(f"{state}: rms", "p95", "max")
    rows = [_row(name, component, states) for name, component in components.items()]
    caption = (
        "Errors before and after compensation: rms, 95th percentile and largest over"
        " the workspace. Percentiles and largest errors are of drawn machines, with the"
        " digits that their number allows."
    )
    if "known" in states:
        caption += (
            " Known: the error that remains if an additional axis, or software, corrects"
            " the component as well."
        )
    return Table(columns, rows, caption)


def _row(name: str, component: ComponentAccuracy, states: Sequence[State]) -> list[str]:
    cells = [
        f"{name} [{text.unit_symbol(component.after.unit)}]",
        "yes" if component.compensatable else "no",
    ]
    for state in states:
        cells += spread_figures(spread_of(component, state))
    return cells


# -- virtual machine, budget, map ------------------------------------------------------
def _realised(
    prediction: PredictionSection, realised: Mapping[str, SpreadRecord]
) -> Table:
    rows, ratios = [], []
    for name, spread in realised.items():
        predicted = math.nan
        if name in prediction.components:
            predicted = prediction.components[name].after.rms
        ratio = spread.rms / predicted if predicted > 0.0 else math.nan
        ratios.append(ratio)
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]", *spread_figures(spread)]
        rows.append([*cells, text.number(predicted), text.fixed(ratio, 2)])
    columns = [
        TableColumn("Component"),
        *TableColumn.numbers(
            "Rms", "p95", "max", "Predicted rms", "Realised / predicted"
        ),
    ]
    caption = (
        "Errors of virtual machines drawn from the tolerances, after their readings of this"
        " plan identified them and they were compensated."
    )
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    if finite:
        low, high = text.fixed(min(finite), 2), text.fixed(max(finite), 2)
        caption += f" Realised over predicted: {low} to {high}."
    return Table(columns, rows, caption)


def _budget_caption(components: Components) -> str:
    """The largest source of each component."""
    shares: dict[str, dict[str, float]] = {}
    for name, component in components.items():
        budget_of = component.budget
        if budget_of:
            source = max(budget_of, key=lambda key: budget_of[key])
            shares.setdefault(source, {})[name] = budget_of[source]
    largest = [_source(source, of) for source, of in shares.items()]
    verdict = (
        f"The largest source is {largest[0]}: reduce it first."
        if len(largest) == 1
        else f"The largest sources are {text.listing(largest)}: reduce them first."
    )
    return f"Sources of the variance that remains. {verdict}"


def _source(source: str, shares: Mapping[str, float]) -> str:
    most = text.percent(max(shares.values()))
    return f"{source} for {text.listing(shares)} (up to {most})"


def _map_caption(prediction: PredictionSection) -> str:
    """Where each component is worst and best."""
    sentences = ["1-sigma error after compensation over the workspace."]
    if set(POLAR) <= set(prediction.map[0].command):
        sentences.append("The angle in the figure is psi, the radius theta.")
    for name in shown_components(prediction):
        errors = component_errors(prediction, name)
        if np.isfinite(errors).any():
            worst = prediction.map[int(np.nanargmax(errors))]
            best = prediction.map[int(np.nanargmin(errors))]
            unit = prediction.components[name].after.unit
            most, least = _error_at(worst, name, unit), _error_at(best, name, unit)
            sentences.append(f"{name} is largest, {most}, and smallest, {least}.")
    return " ".join(sentences)


def _error_at(point: MapPoint, name: str, unit: str) -> str:
    error = text.quantity(point.after[name], unit)
    return f"{error}, at {text.named_quantities(point.command, 4)}"


CHAPTER: Final = Chapter("accuracy", "Residual accuracy", blocks, printed)

# Blocks on how far single machines differ, on other references and other tools.

FIGURE_NAMES: Final = {
    "absolute": "absolute",
    "home": "zeroed at home",
    "best_fit": "best rigid fit",
}


def range_blocks(prediction: PredictionSection) -> list[Block]:
    """Intervals over machines, each reference, each tool; what is stored of them."""
    content: list[Block] = []
    after = {name: c.after for name, c in prediction.components.items()}
    if any(spread.rms_interval for spread in after.values()):
        content.append(_intervals(after))
    if prediction.references:
        references = {
            text.meaning(name, FIGURE_NAMES): spreads
            for name, spreads in prediction.references.items()
        }
        caption = "Errors after compensation against each reference."
        content.append(_spread_table(references, caption))
    if prediction.tools:
        tools = {
            text.quantity(t.length, t.unit): t.components for t in prediction.tools
        }
        caption = "Errors after compensation at tools longer than the reference one."
        content.append(_spread_table(tools, caption))
    return content


def _intervals(after: Mapping[str, SpreadRecord]) -> Table:
    columns = [TableColumn("Component"), *TableColumn.numbers("rms", "p95", "max")]
    rows = []
    for name, spread in after.items():
        cells = [_span(spread, figure) for figure in ("rms", "p95", "max")]
        rows.append([f"{name} [{text.unit_symbol(spread.unit)}]", *cells])
    caption = (
        "What a single machine can expect of the geometry alone: 95 % of the machines have"
        " these figures over their workspace between these ends."
    )
    return Table(columns, rows, caption)


def _span(spread: SpreadRecord, figure: str) -> str:
    """Both ends of the interval of a figure, empty without one."""
    ends = getattr(spread, f"{figure}_interval")
    if ends is None:
        return ""
    errors = spread.monte_carlo.get(f"{figure}_interval", [math.nan, math.nan])
    low, high = (text.drawn(v, e) for v, e in zip(ends, errors, strict=True))
    return f"{low} to {high}"


def _spread_table(
    spreads: Mapping[str, Mapping[str, SpreadRecord]], caption: str
) -> Table:
    """Rms, p95 and max of each component, for each title of `spreads` side by side."""
    columns = [TableColumn("Component")]
    for title in spreads:
        columns += TableColumn.numbers(f"{title}: rms", "p95", "max")
    rows = []
    for name, spread in next(iter(spreads.values())).items():
        cells = [f"{name} [{text.unit_symbol(spread.unit)}]"]
        for components in spreads.values():
            cells += spread_figures(components[name])
        rows.append(cells)
    return Table(columns, rows, caption)


def spread_figures(spread: SpreadRecord) -> list[str]:
    """Rms, 95th percentile and largest error, with the digits that the draws allow."""
    cells = []
    for name in ("rms", "p95", "max"):
        error = next(iter(spread.monte_carlo.get(name, [])), math.nan)
        cells.append(text.drawn(getattr(spread, name), error))
    return cells


# Blocks on the uncertainty budget: its lines, what to improve, effects outside it.

MIN_SHARE: Final = 1e-3  #: size of a share below which it is no more than that
#: what each kind of line is
LINE_KINDS: Final = {
    "instrument": "the stated noise of single readings",
    "run": "errors that the readings of a run share",
    "course": "errors that all runs share in the course of the session",
    "noise law": "noise beyond the stated one, and what is not known of it",
    "set-up": "what the unknowns of the set-ups cost: where a cup or a tracker stands",
    "effects": "what is not known of the effects in the model",
    "prior": "what the readings leave to the tolerances",
    "unmodelled": "what is not known of effects beside the geometry",
    "linearisation": "what a linear calculation leaves out",
    "interpolation": "what lies between the nodes of a grid",
    "rounding": "printed digits",
}


def budget_blocks(section: BudgetSection, components: Components) -> list[Block]:
    """The lines, advice, and effects that are not modelled."""
    shown = [n for n, c in components.items() if c.compensatable] or list(components)
    units = {name: components[name].after.unit for name in shown}
    content: list[Block] = [_lines(section, units)]
    if section.no_axes:
        content.append(_axes(section, components))
    if section.advice:
        content.append(Paragraph(text.replace_symbols(" ".join(section.advice))))
    if section.unmodelled:
        after = {name: components[name].after.rms for name in shown}
        content.append(_unmodelled(section.unmodelled, after, units))
        hidden = [u for u in section.unmodelled if u.not_testable]
        if hidden:
            content.append(Paragraph(_hidden(hidden)))
    return content


def _axes(section: BudgetSection, components: Components) -> Table:
    """What no drive corrects, without and with additional axes."""
    rows = [
        [
            f"{name} [{text.unit_symbol(components[name].after.unit)}]",
            text.number(without),
            text.number(section.predicted[name]),
        ]
        for name, without in section.no_axes.items()
    ]
    columns = [
        TableColumn("Component"),
        *TableColumn.numbers("Without additional axes", "With additional axes"),
    ]
    caption = (
        "Rms error of what no drive of this machine corrects, and what stays where"
        " additional axes take the known error back."
    )
    return Table(columns, rows, caption)


def _lines(section: BudgetSection, units: Mapping[str, str]) -> Table:
    columns = [TableColumn("Source"), TableColumn("What it is", wide=True)]
    for name, unit in units.items():
        columns += TableColumn.numbers(f"{name} [{text.unit_symbol(unit)}]", "share")
    rows = []
    for line in section.lines:
        row = [line.source, LINE_KINDS.get(line.kind, line.kind)]
        for name in units:
            share = line.share[name]
            shown = (
                f"under 0.1{text.NO_BREAK}%"
                if 0 < abs(share) < MIN_SHARE
                else text.percent(share)
            )
            row += [text.number(line.size[name]), shown]
        rows.append(row)
    total = ["all", "predicted rms error"]
    for name in units:
        total += [text.number(section.predicted[name]), "100 %"]
    caption = (
        "Uncertainty budget: what each source adds when those above it are gone, and its"
        " share of the predicted variance. The shares add up to 100 %; a negative one means"
        " that other lines count part of it as well."
    )
    return Table(columns, [*rows, total], caption)


def _unmodelled(
    lines: Sequence[UnmodelledLine],
    after: Mapping[str, float],
    units: Mapping[str, str],
) -> Table:
    columns = [TableColumn("Effect"), TableColumn("Expected size")]
    for name, unit in units.items():
        columns += TableColumn.numbers(f"{name} [{text.unit_symbol(unit)}]")
    columns.append(TableColumn("What to do", wide=True))
    rows = [["none: geometry alone", "", *(text.number(v) for v in after.values()), ""]]
    for line in lines:
        values = [text.number(line.with_it[name]) for name in after]
        rows.append([line.effect, line.expected, *values, line.remedy])
    caption = (
        "What usually goes unmodelled: rms error of the compensated machine if one"
        " effect has its expected size and the calibration does not know of it. What an"
        " effect adds grows in proportion to its size, which may be 30 times as large."
    )
    return Table(columns, rows, caption)


def _hidden(lines: Sequence[UnmodelledLine]) -> str:
    reasons: dict[str, list[str]] = {}
    for line in lines:
        reasons.setdefault(line.not_testable or "", []).append(line.effect)
    parts = [
        f"{text.listing(effects)} ({reason})" for reason, effects in reasons.items()
    ]
    return f"These readings cannot find {text.listing(parts)}."
