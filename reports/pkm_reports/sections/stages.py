"""Chapter: which measurement at which stage, and why this plan.

Only plans with a schedule have it: their stages have times (`begin_min`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from oed.base import Array
from oed.result import (
    AlternativePlan,
    MachineInfo,
    PlanSection,
    Sd,
    StageRecord,
    StudyResult,
)
from oed.text import shorten
from pkm_reports import missing, style, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Items,
    Notice,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    headed_list,
    transposed,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections.plan import (
    budget_phrase,
    budget_share,
    has_schedule,
    is_missed,
    minutes,
    recording_blocks,
    remaining_errors,
)

# Tables of a plan stage by stage: schedule, improved parameters, accuracy.

MAX_PARAMETERS: Final = 4  #: parameters named for each stage, those that improve most
#: parameters and combinations named that are not yet determined
MAX_UNDETERMINED: Final = 8
#: factor below which a standard deviation counts as unchanged by a stage
MIN_FACTOR: Final = 1.05
#: characters of a combination of parameters; longer ones are cut
MAX_TERMS_LENGTH: Final = 56
NO_LOSS: Final = 0.005  #: expected losses that are written as none


def schedule(plan: PlanSection) -> Table:
    """The stages in order: when, what, how many readings, what they determine."""
    stages = plan.stages
    columns = TableColumn.numbers("Stage", "Minutes")
    columns += [
        TableColumn("Measurement", wide=True),
        TableColumn("Set-ups", wide=True),
    ]
    cells = [
        [str(k) for k in range(1, len(stages) + 1)],
        [_span(stage) for stage in stages],
        [stage.measurement for stage in stages],
        [text.listing(stage.setups) for stage in stages],
    ]
    if any(stage.operator for stage in stages):
        columns.append(TableColumn("Operator"))
        cells.append([stage.operator or text.MISSING for stage in stages])
    columns += TableColumn.numbers(
        "Readings", "Expected lost", "Rank alone", "Rank so far"
    )
    cells += [
        [str(stage.readings) for stage in stages],
        [_lost(stage) for stage in stages],
        [str(stage.identifies) for stage in stages],
        [text.MISSING if s.rank is None else str(s.rank) for s in stages],
    ]
    if any(stage.price for stage in stages):
        columns += TableColumn.numbers("Price")
        cells.append([text.trimmed(stage.price) for stage in stages])
    return Table(columns, transposed(cells), _schedule_table_caption(plan))


def _span(stage: StageRecord) -> str:
    begin, end = text.trimmed(stage.begin_min, 3), text.trimmed(stage.end_min, 3)
    return f"{begin}–{end}"


def _lost(stage: StageRecord) -> str:
    if stage.lost is None:
        return text.MISSING
    lost = "0" if stage.lost < NO_LOSS else text.trimmed(stage.lost, 2)
    return f"{lost} of {stage.chosen}" if stage.chosen else lost


def _schedule_table_caption(plan: PlanSection) -> str:
    cost, budget = minutes(plan.cost), budget_share(plan)
    sentences = [
        f"The stages in order; together they take {cost}{budget}.",
        "Lost: candidates (readings or whole runs) expected outside the instrument's"
        " travel.",
        "Rank alone: directions that the stage's own readings determine, including the"
        " unknowns of its set-ups.",
        "Rank so far: directions of the machine's parameters.",
    ]
    chances = missing.finite(
        missing.entry(stage.available, "least") for stage in plan.stages
    )
    if chances:
        least = text.percent(min(chances))
        sentences.append(
            f"The least certain reading succeeds with a chance of {least}."
        )
    neglected = missing.finite(stage.cut_off_um for stage in plan.stages)
    if neglected:
        largest = text.quantity(neglected[-1], "um")
        sentences.append(
            f"After the last stage, linearisation neglects at most {largest} of a"
            " reading."
        )
    return " ".join(sentences)


def improvements(plan: PlanSection, machine: MachineInfo) -> Table:
    """Which parameters each stage improves most, and what is not yet determined."""
    before = _tolerances(machine)
    rows = []
    for k, stage in enumerate(plan.stages, 1):
        after = stage.parameters
        undetermined = [shorten_combination(terms) for terms in stage.unidentified]
        rows.append(
            [
                str(k),
                stage.measurement,
                _most_improved(before, after),
                text.listing(undetermined, MAX_UNDETERMINED) or "nothing",
            ]
        )
        before = after
    columns = [
        TableColumn("Stage", number=True),
        TableColumn("Measurement"),
        TableColumn("Improved most", wide=True),
        TableColumn("Not yet determined", wide=True),
    ]
    caption = (
        "What each stage identifies: the parameters whose standard deviations it"
        " improves most, with the factor against their tolerances or the stage before."
        " Not yet determined are parameters and combinations that no reading so far"
        " determines."
    )
    return Table(columns, rows, caption)


def _tolerances(machine: MachineInfo) -> dict[str, Sd]:
    """Standard deviation of each parameter before any reading."""
    tolerances = {}
    for row in machine.parameters:
        sd = row.get("tolerance")
        if isinstance(sd, (int, float)):
            tolerances[str(row["name"])] = Sd(sd, str(row["unit"]))
    return tolerances


def _most_improved(before: Mapping[str, Sd], after: Mapping[str, Sd]) -> str:
    """The few parameters that improve most: db1y 0.012 mm (84×)."""
    factors = {}
    for name, now in after.items():
        if name in before and _is_improved(before[name], now):
            factors[name] = before[name].sd / now.sd
    if not factors:
        return "none"
    best = sorted(factors, key=lambda name: -factors[name])[:MAX_PARAMETERS]
    entries = [_improvement(name, after[name], factors[name]) for name in best]
    more = len(factors) - len(best)
    return ", ".join(entries) + (f" and {more} more" if more else "")


def _is_improved(before: Sd, after: Sd) -> bool:
    same_unit = before.unit == after.unit
    return same_unit and after.sd > 0.0 and before.sd > MIN_FACTOR * after.sd


def _improvement(name: str, after: Sd, factor: float) -> str:
    sd = text.quantity(after.sd, after.unit, 2)
    return f"{name} {sd} ({text.number(factor, 2)}×)"


def shorten_combination(combination: str) -> str:
    """A combination of parameters, a long one without its last terms."""
    if len(combination) <= MAX_TERMS_LENGTH:
        return combination
    opening = combination[: MAX_TERMS_LENGTH + 1]
    if " " not in opening:
        return shorten(opening, MAX_TERMS_LENGTH)
    last_term = max(opening.rfind(" + "), opening.rfind(" - "))
    return f"{opening[:last_term]} ..."


def accuracy_table(plan: PlanSection) -> Table:
    """Accuracy before, after each stage and as wanted; virtual machines below each."""
    keys = components(plan)
    start = "before" if plan.after else "before any reading"
    rows = [[start, *cells(plan.start_accuracy, keys)]]
    marks = [""]
    for k, stage in enumerate(plan.stages, 1):
        mark = "chosen" if k == len(plan.stages) else ""
        rows.append([f"after stage {k}", *cells(stage.accuracy, keys)])
        marks.append(mark)
        reached = realised(stage)
        if reached:
            label = "… realised, virtual machines"
            rows.append([label, *cells(reached, keys)])
            marks.append(mark)
    if plan.goal:
        rows.append(["wanted", *cells(plan.goal, keys)])
        marks.append("")
    if is_missed(plan):
        label = "most accurate plan found"
        rows.append([label, *cells(plan.best_reachable, keys)])
        marks.append("")
    titles = [text.heading(key) for key in keys]
    columns = [TableColumn("When", wide=True), *TableColumn.numbers(*titles)]
    caption = "Accuracy of each component, rms over the workspace, stage by stage."
    return Table(columns, rows, caption, marks)


# Whether the plan reaches its goal, how close to the best it is, when to stop.
def verdict_blocks(plan: PlanSection) -> list[Block]:
    """What is known before, the verdict, what would improve it, the bound, the stop."""
    content: list[Block] = []
    if plan.after:
        content.append(Paragraph(f"Known before: {text.add_full_stop(plan.after)}"))
    needs = text.sentences(plan.needs)
    if is_missed(plan):
        content.append(Notice(_missed(plan)))
        content += headed_list("What would have to change:", needs)
    else:
        content.append(Paragraph(_reached(plan)))
        content += headed_list("What would make it more accurate:", needs)
    if plan.bound is not None:
        content.append(Paragraph(_bound(plan, plan.bound)))
    if plan.stop:
        content.append(Paragraph(f"When to stop: {text.add_full_stop(plan.stop)}"))
    return content


def _missed(plan: PlanSection) -> str:
    goal, within = accuracies(plan.goal), budget_phrase(plan)
    notice = f"The goal is out of reach{within}: {goal}."
    best = accuracies(plan.best_reachable, plan.goal)
    if not best:
        return notice
    return f"{notice} The most accurate plan found reaches {best}."


def _reached(plan: PlanSection) -> str:
    stages = text.count(len(plan.stages), "stage")
    costs = f"{minutes(plan.cost)}{budget_share(plan)}"
    if plan.price:
        costs += f", at a price of {text.trimmed(plan.price)}"
    content = f"has {stages} and takes {costs}."
    accuracy = accuracies(plan.accuracy)
    if accuracy:
        content += f" It reaches {accuracy} (rms over the workspace)."
    if plan.goal:
        goal = accuracies(plan.goal)
        return f"The goal ({goal}) is reached. The least costly plan found {content}"
    return f"The most accurate plan found {content}"


def _bound(plan: PlanSection, bound: float) -> str:
    """How far the plan can be from the best one."""
    value, subject = "the remaining share of the error", "this plan"
    if plan.goal:
        value = "the worst ratio of error to wanted accuracy"
        subject = "the most accurate plan found"
    within = budget_phrase(plan)
    sentence = f"No plan{within} brings {value} below {text.number(bound)}"
    if plan.loss is not None:
        loss = loss_bound(plan.loss)
        sentence += f": {subject} is {loss} worse than the best possible one"
    if plan.lines:
        sentence += f" (proven with {text.count(plan.lines, 'supporting line')})"
    return f"{sentence}."


def loss_bound(loss: float) -> str:
    """A guaranteed loss, never rounded down; a large one as a factor."""
    if loss >= 1.0:
        return f"at most a factor of {text.factor_at_most(1.0 + loss)}"
    return f"at most {text.percent_at_most(loss)}"


# Accuracies and measurements of a plan in words.
def accuracies(table: Mapping[str, float], only: Iterable[str] | None = None) -> str:
    """z 30.0 µm and theta 2.00 arcsec; of all components, or of some (`only`)."""
    parts = []
    for key in table if only is None else only:
        rms = missing.entry(table, key)
        if math.isfinite(rms):
            stem, unit = text.split_unit(key)
            parts.append(f"{stem}{text.NO_BREAK}{text.quantity(rms, unit)}")
    return text.listing(parts)


def measurements(plan: AlternativePlan) -> str:
    """The measurements of a plan in order: rough tracker (12) → bar 300 (24)."""
    steps = []
    for k, name in enumerate(plan.names):
        has_readings = k < len(plan.readings)
        steps.append(f"{name} ({plan.readings[k]})" if has_readings else name)
    return " → ".join(steps) or "no reading"


def cells(table: Mapping[str, float], keys: Iterable[str]) -> list[str]:
    """Numbers of a table row."""
    return [text.number(missing.entry(table, key)) for key in keys]


# Chapter: which measurement at which stage, and why this plan.
def blocks(result: StudyResult) -> list[Block]:
    """Verdict, stages, accuracy and time, alternatives, sequences of the study."""
    plan = result.plan
    if plan is None or not has_schedule(plan):
        return []
    return [
        *verdict_blocks(plan),
        schedule(plan),
        improvements(plan, result.machine),
        accuracy_table(plan),
        *_effects(plan),
        *_virtual_machines(plan),
        *_pictures(plan),
        *_alternatives(plan),
        *sequences(plan),
    ]


def printed(result: StudyResult) -> list[Block]:
    """Stages, and the accuracy after each."""
    plan = result.plan
    if plan is None or not has_schedule(plan):
        return []
    return [schedule(plan), accuracy_table(plan)]


def _pictures(plan: PlanSection) -> list[Block]:
    return [
        Picture("plan_stages", lambda: draw_accuracies(plan), _accuracy_caption(plan)),
        Picture("plan_timeline", lambda: draw_timeline(plan), _schedule_caption(plan)),
        Picture("plan_front", lambda: draw_front(plan), _front_caption(plan)),
    ]


CHAPTER: Final = Chapter("stages", "Which measurement at which stage", blocks, printed)


# -- the plan that allows for effects, beside one for a machine without ----------------
def _effects(plan: PlanSection) -> list[Block]:
    """A sentence, and the accuracy that each plan promises and reaches."""
    allowed = plan.effects
    if allowed is None:
        return []
    errors = {
        "promised without effects": allowed.promised,
        "that plan with effects": allowed.without.accuracy,
        "this plan": plan.accuracy,
    }
    caption = (
        "Predicted errors over the workspace: what the plan for a machine without effects"
        " promises, what its readings leave on a machine with them, and what this plan"
        " leaves there."
    )
    sentence = (
        f"The plan allows for {text.count(allowed.groups, 'group')} of effects beside the"
        " geometry, at the sizes expected of them. The plan for a machine without effects"
        f" would be {', then '.join(allowed.without.names)}."
    )
    table = remaining_errors(errors, allowed.promised, caption)
    return [Paragraph(sentence), table, *recording_blocks(allowed.recording)]


# -- what virtual machines achieved ----------------------------------------------------
def _virtual_machines(plan: PlanSection) -> list[Block]:
    """Their errors, intervals and lost candidates against the predicted ones."""
    stages = plan.stages
    ratios = missing.finite(r for stage in stages for r in stage.realised.values())
    if not ratios:
        return []
    count = plan.virtual_machines
    machines = text.count(count, "virtual machine") if count else "Virtual machines"
    low, high = text.number(min(ratios)), text.number(max(ratios))
    sentences = [
        f"{machines} went through all stages: their errors are {low} to {high} of the"
        " predicted ones."
    ]
    coverage = missing.finite(stage.coverage for stage in stages)
    if coverage:
        interval = f"95{text.NO_BREAK}%"
        sentences.append(
            f"Their {interval} intervals contain {_range(coverage)} of the true"
            " parameters."
        )
    lost = missing.finite(stage.realised_lost for stage in stages)
    if lost:
        expected = sum(missing.finite(stage.lost for stage in stages))
        sentences.append(
            f"They lost {text.trimmed(sum(lost), 3)} candidates on average;"
            f" {text.trimmed(expected, 3)} were expected."
        )
    return [Paragraph(" ".join(sentences))]


def _range(shares: Sequence[float]) -> str:
    low, high = text.percent(min(shares)), text.percent(max(shares))
    return low if low == high else f"{low} to {high}"


# -- plans that were considered and not taken ------------------------------------------
def _alternatives(plan: PlanSection) -> list[Block]:
    described = [entry for entry in plan.alternatives if isinstance(entry, str)]
    sentences = headed_list("Alternatives considered:", text.sentences(described))
    others = alternatives(plan)
    if not others:
        return sentences
    columns = [
        TableColumn("Plan (readings or runs)", wide=True),
        *TableColumn.numbers("Minutes", "Value"),
        TableColumn("Why not", wide=True),
    ]
    rows = [
        [
            measurements(other),
            text.number(other.minutes),
            text.number(other.value),
            text.sentence(other.why) or text.MISSING,
        ]
        for other in others
    ]
    value = (
        "error of the worst component over its wanted accuracy"
        if plan.goal
        else "remaining share of the error"
    )
    cost, of_plan = minutes(plan.cost), text.number(plan.value)
    caption = (
        f"Plans that were considered and not taken. Value: {value}, smaller is better."
        f" The plan itself: {cost}, value {of_plan}."
    )
    return [Table(columns, rows, caption), *sentences]


NO_TIME: float = 0.5  #: minutes below which no time is said to remain


def _accuracy_caption(plan: PlanSection) -> str:
    """What remains of each component, against what it was."""
    sentences = [
        "Predicted rms error of each component after each stage, on log scales."
    ]
    gains = _gains(plan)
    if gains:
        sentences.append(_gain(gains))
    if any(stage.realised for stage in plan.stages):
        sentences.append("Diamonds are the errors of virtual machines.")
    if plan.goal:
        sentences.append("Dotted lines are the wanted accuracies.")
    return " ".join(sentences)


def _gains(plan: PlanSection) -> dict[str, float]:
    """Factor by which the whole plan improves each component."""
    after = plan.stages[-1].accuracy
    return {
        key: plan.start_accuracy[key] / rms
        for key, rms in after.items()
        if rms > 0.0 and key in plan.start_accuracy
    }


def _gain(gains: dict[str, float]) -> str:
    low = min(gains, key=lambda key: gains[key])
    high = max(gains, key=lambda key: gains[key])
    sentence = f"The plan as a whole makes {_improved(low, gains)}"
    if high != low:
        sentence += f" and {_improved(high, gains)}"
    return f"{sentence}."


def _improved(key: str, gains: dict[str, float]) -> str:
    return f"{text.split_unit(key)[0]} {text.times(gains[key])} as accurate"


def _schedule_caption(plan: PlanSection) -> str:
    """How long the plan takes, and how much of the budget remains."""
    cost, budget = minutes(plan.cost), budget_share(plan)
    caption = f"The stages over time: {cost}{budget}."
    if plan.budget_min is None or plan.budget_min - plan.cost <= NO_TIME:
        return caption
    return f"{caption} {minutes(plan.budget_min - plan.cost)} remain."


def _front_caption(plan: PlanSection) -> str:
    """What more time buys."""
    sentences = ["The value of plans against the time that they take."]
    if plan.front:
        sentences.append(
            "No plan found is both shorter and more accurate than a plan on the line."
        )
    if plan.bound is not None:
        sentences.append("No plan within the budget lies in the shaded region.")
    front = points(plan.front)
    if len(front) > 1:
        (first, start), (last, end) = front[0], front[-1]
        sentences.append(
            f"From {minutes(first)} to {minutes(last)} the value falls"
            f" from {text.number(start)} to {text.number(end)}."
        )
    more = len(plan.compared) - MAX_PARETO_PLANS
    if more > 0:
        sentences.append(f"{more} more sequences are in the table only.")
    return " ".join(sentences)


# -- sequences that the study asks for -------------------------------------------------
def sequences(plan: PlanSection) -> list[Block]:
    """What the sequences determine, how they compare, and what follows from it."""
    compared = plan.compared
    if not compared:
        return []
    content: list[Block] = [_ranks(plan), _comparison(plan)]
    sentences = [f"{s.name}: {text.sentence(s.words)}" for s in compared if s.words]
    if sentences:
        content.append(Items(sentences))
    return content


def _ranks(plan: PlanSection) -> Table:
    compared = plan.compared
    indices = list(dict.fromkeys(key for s in compared for key in s.observability))
    columns = [
        TableColumn("Sequence", wide=True),
        *TableColumn.numbers("Readings", "Minutes", "Rank", "κ", "Weakest"),
        *TableColumn.numbers(*indices, "Lost"),
    ]
    cells = [
        [s.name for s in compared],
        [_total(s.sequence) for s in compared],
        [text.number(s.sequence.minutes) for s in compared],
        [f"{s.rank} of {s.parameters}" for s in compared],
        [text.number(s.kappa, 4) for s in compared],
        [text.number(s.weakest) for s in compared],
    ]
    for index in indices:
        cells.append(
            [text.number(missing.entry(s.observability, index)) for s in compared]
        )
    cells.append([text.trimmed(s.lost, 2) for s in compared])
    caption = (
        "Sequences that the study asks for, with all readings of each measurement."
        " Weakest: the smallest singular value (lengths in mm, angles times the lever)."
        " O1 to O5 are the observability indices, larger is better; the smaller κ, the"
        " better."
    )
    return Table(columns, transposed(cells), caption)


def _total(plan: AlternativePlan) -> str:
    return text.trimmed(sum(plan.readings)) if plan.readings else text.MISSING


def _comparison(plan: PlanSection) -> Table:
    """Three rows for each sequence: itself, the best plan of its time, the gain."""
    plans = [one for s in plan.compared for one in (s.sequence, s.plan)]
    keys = list(dict.fromkeys(key for one in plans for key in one.accuracy))
    rows, marks = [], []
    for record in plan.compared:
        best = measurements(record.plan)
        rows.append(_row(record.name, record.sequence, "", keys))
        rows.append(_row(best, record.plan, text.number(record.bound), keys))
        marks += ["", "chosen"]
        if record.gain:
            factors = [text.times(component_label(record.gain, key)) for key in keys]
            rows.append(["… times as accurate", "", "", "", *factors])
            marks.append("chosen")
    columns = [
        TableColumn("Sequence", wide=True),
        *TableColumn.numbers("Minutes", "Value", "Bound"),
        *TableColumn.numbers(*[text.heading(key) for key in keys]),
    ]
    caption = (
        "Each sequence, and below it (marked) the best plan found in its time: value"
        " (smaller is better) and rms error of each component. No plan of that time has"
        " a value below the bound."
    )
    return Table(columns, rows, caption, marks)


def _row(
    name: str, plan: AlternativePlan, bound: str, keys: Sequence[str]
) -> list[str]:
    head = [name, text.number(plan.minutes), text.number(plan.value), bound]
    return [*head, *cells(plan.accuracy, keys)]


# Accuracy of each pose component after each stage of a plan, on a log scale.

REALISED: Final = "realised, virtual machines"
WANTED: Final = "wanted"
MAX_TICKS: Final = 12
#: shift of the diamonds, so that the line's own marks do not hide them
MARK_SHIFT: Final = 0.09


def draw_accuracies(plan: PlanSection) -> style.Figure:
    """A line for each component; lengths and angles have panels of their own."""
    keys = components(plan)
    if not keys:
        return style.empty("No accuracy after the stages is stored in this result.")
    units = list(dict.fromkeys(text.split_unit(key)[1] for key in keys))
    figure = style.figure(2.9)
    panels = figure.subplots(1, len(units), squeeze=False)[0]
    for axes, unit in zip(panels, units, strict=True):
        for k, key in enumerate(keys):
            if text.split_unit(key)[1] == unit:
                colour = style.CYCLE[k % len(style.CYCLE)]
                _component(axes, key, plan, colour, style.marker(k))
        of_unit = f" [{text.unit_symbol(unit)}]" if unit else ""
        axes.set(xlabel="after stage", ylabel=f"rms error{of_unit}")
        _set_ticks(axes, len(plan.stages))
        style.log_axis(axes, "y")
    entries = style.legend_entries(panels)
    for label in (WANTED, REALISED):  # the last entries of the legend
        if label in entries:
            entries[label] = entries.pop(label)
    style.legend_below(figure, entries)
    return figure


def components(plan: PlanSection) -> list[str]:
    """Names with units (`z_um`) of components with at least one positive accuracy."""
    tables = [plan.start_accuracy, *[stage.accuracy for stage in plan.stages]]
    positive = [key for table in tables for key, rms in table.items() if rms > 0.0]
    return list(dict.fromkeys(positive))


def realised(stage: StageRecord) -> dict[str, float]:
    """Accuracy that virtual machines reached: the prediction times their ratio to it."""
    ratios = {key: component_label(stage.realised, key) for key in stage.accuracy}
    reached = {key: ratios[key] * rms for key, rms in stage.accuracy.items()}
    return {key: rms for key, rms in reached.items() if math.isfinite(rms)}


def component_label(table: Mapping[str, float], key: str) -> float:
    """The number of a component, stored with its unit in the name or without."""
    return missing.entry(table, key if key in table else stem(key))


def stem(key: str) -> str:
    """The component's name without its unit: z_um -> z."""
    return key.rpartition("_")[0] if text.split_unit(key)[1] else key


def _component(
    axes: style.Axes, key: str, plan: PlanSection, colour: str, marker: str
) -> None:
    positions = np.arange(len(plan.stages) + 1)
    tables = [plan.start_accuracy, *[stage.accuracy for stage in plan.stages]]
    predicted = _positive(missing.column(tables, key))
    label = style.label(text.split_unit(key)[0])
    axes.plot(positions, predicted, color=colour, marker=marker, label=label)
    tables = [{}, *[realised(stage) for stage in plan.stages]]
    reached = _positive(missing.column(tables, key))
    if np.isfinite(reached).any():
        axes.plot(positions + MARK_SHIFT, reached, "D", label=REALISED, **style.DIAMOND)
    wanted = missing.entry(plan.goal, key)
    if wanted > 0.0:
        axes.axhline(wanted, color=colour, ls=":", lw=1.0)
        axes.plot([], [], color=style.GREY, ls=":", lw=1.0, label=WANTED)


def _positive(values: Array) -> Array:
    """Numbers; NaN for what a log axis cannot show."""
    return np.where(values > 0.0, values, np.nan)


def _set_ticks(axes: style.Axes, count: int) -> None:
    """`before`, then the stages by number; of many stages, every other or so."""
    step = 1 + (count - 1) // MAX_TICKS
    places = [0, *range(step, count + 1, step)]
    style.fixed_ticks(axes, "x", places, ["before", *[str(k) for k in places[1:]]])
    axes.set_xlim(-0.25, count + 0.3)


# The stages of a plan over time, against the budget.

#: shares of the axis: bars that end after the first have their words inside or before
LATE, ROOM_BEFORE = 0.62, 0.38


def draw_timeline(plan: PlanSection) -> style.Figure:
    """A bar for each stage, the first on top."""
    stages = [stage for stage in plan.stages if stage.begin_min is not None]
    if not stages:
        return style.empty("No times of stages are stored in this result.")
    figure = style.figure(0.95 + 0.34 * len(stages))
    axes = figure.subplots()
    last = stages[-1]
    right = max(missing.finite([last.begin_min, last.end_min, plan.budget_min]))
    for k, stage in enumerate(stages):
        _bar(axes, k, stage, right)
    if plan.budget_min is not None:
        label = f"budget: {text.trimmed(plan.budget_min)} min"
        line: Any = {"color": style.RED, "ls": "--", "lw": 1.0}
        axes.axvline(plan.budget_min, label=label, **line)
    names = [
        f"{k}  {style.label(stage.measurement, 28)}"
        for k, stage in enumerate(stages, 1)
    ]
    style.fixed_ticks(axes, "y", range(len(stages)), names)
    axes.set_xlabel("minutes")
    axes.set_xlim(0.0, 1.02 * right)
    axes.set_ylim(len(stages) - 0.4, -0.6)
    axes.grid(False, axis="y")
    style.legend_below(figure, style.legend_entries([axes]))
    return figure


def _bar(axes: style.Axes, k: int, stage: StageRecord, right: float) -> None:
    """One stage, with its readings and minutes written where there is room."""
    begin = or_nan(stage.begin_min)
    end = begin + stage.cost if stage.end_min is None else stage.end_min
    bar: Any = {"color": style.SKY, "label": "mounting and reading"}
    axes.barh(k, end - begin, 0.6, left=begin, **bar)
    readings = text.count(stage.readings, "reading")
    phrase = f"{readings}, {text.number(end - begin)} min"
    letters: Any = {"va": "center", "fontsize": 7}
    if end <= LATE * right:
        axes.text(end, k, f" {phrase}", ha="left", **letters)
    elif begin > ROOM_BEFORE * right:
        axes.text(begin, k, f"{phrase} ", ha="right", **letters)
    else:
        axes.text(begin, k, f" {phrase}", ha="left", **letters)


MAX_PARETO_PLANS: Final = 6  #: sequences shown by name; more are in the table only
#: a range of minutes wider than this factor is drawn on a log scale
LOG_RANGE: Final = 30.0
GOAL_LABEL: Final = "error of the worst component\nover its wanted accuracy"
NO_GOAL_LABEL: Final = (
    "remaining error over that\nbefore any reading (rms of components)"
)


def draw_front(plan: PlanSection) -> style.Figure:
    """Minutes against the value that plans are judged by, the smaller the better."""
    front = points(plan.front)
    chosen = _points([(plan.cost, or_nan(plan.value))])
    rejected = points(alternatives(plan))
    sequences = points([s.sequence for s in plan.compared])
    plans = np.vstack([front, chosen, rejected, sequences])
    if not len(plans):
        return style.empty("No plans of other times are stored in this result.")
    figure = style.figure(3.3)
    axes = figure.subplots()
    _set_limits(axes, plans, plan)
    _draw_limits(axes, plan)
    if len(rejected):
        axes.plot(*rejected.T, "x", color=style.GREY, ms=5, label="considered")
    if len(front):
        line: Any = {"color": style.BLUE, "drawstyle": "steps-post"}
        axes.plot(*front.T, "o-", label="best plan found for the time", **line)
    _draw_sequences(axes, plan)
    if len(chosen):
        star: Any = {"color": style.ORANGE, "mec": style.INK, "mew": 0.6, "ms": 12}
        axes.plot(*chosen.T, "*", label="the plan", zorder=5, **star)
    style.log_axis(axes, "y")
    axes.set(xlabel="minutes", ylabel=GOAL_LABEL if plan.goal else NO_GOAL_LABEL)
    entries = style.legend_entries([axes])
    style.legend_below(figure, entries, min(2, style.legend_columns(list(entries))))
    return figure


def alternatives(plan: PlanSection) -> list[AlternativePlan]:
    """Plans that were considered and not taken; some results hold sentences as well."""
    return [entry for entry in plan.alternatives if isinstance(entry, AlternativePlan)]


def points(plans: Sequence[AlternativePlan]) -> Array:
    """Minutes and value (n, 2) of the plans whose value is positive."""
    return _points([(plan.minutes, plan.value) for plan in plans])


def _points(pairs: Sequence[tuple[float, float]]) -> Array:
    table = np.array(pairs, dtype=float).reshape(-1, 2)
    finite = np.isfinite(table).all(axis=1)
    positive = table[:, 1] > 0.0
    return np.asarray(table[finite & positive])


def _set_limits(axes: style.Axes, plans: Array, plan: PlanSection) -> None:
    minutes = np.append(plans[:, 0], missing.finite([plan.budget_min]))
    bounds = missing.finite([plan.bound, *[s.bound for s in plan.compared]])
    bounds += [1.0] if plan.goal else []
    values = np.append(plans[:, 1], [bound for bound in bounds if bound > 0.0])
    axes.set_yscale("log")
    axes.set_ylim(values.min() / 1.35, 1.35 * values.max())
    positive = minutes[minutes > 0.0]
    if len(positive) and positive.max() > LOG_RANGE * positive.min():
        axes.set_xscale("log")
        axes.set_xlim(positive.min() / 1.2, 1.12 * positive.max())
        style.log_axis(axes, "x")
    else:
        axes.set_xlim(0.0, 1.06 * max(minutes.max(), 1e-9))


def _draw_limits(axes: style.Axes, plan: PlanSection) -> None:
    """Shade what no plan reaches, and mark the budget and the goal."""
    start, end = axes.get_xlim()
    budget, bound = or_nan(plan.budget_min), or_nan(plan.bound)
    if bound > 0.0:
        span = [start, budget if math.isfinite(budget) else end]
        shade: Any = {"color": style.LIGHT, "lw": 0, "zorder": 0}
        label = "no plan within the budget is better"
        axes.fill_between(span, axes.get_ylim()[0], bound, label=label, **shade)
        axes.plot(span, [bound, bound], color=style.GREY, lw=0.8)
    if math.isfinite(budget):
        label = f"budget: {text.trimmed(budget)} min"
        axes.axvline(budget, color=style.RED, ls="--", lw=1.0, label=label)
    if plan.goal:
        label = "below: the goal is reached"
        axes.axhline(1.0, color=style.GREEN, ls=":", lw=1.3, label=label)


def _draw_sequences(axes: style.Axes, plan: PlanSection) -> None:
    """Sequences that the study asked for, each with the bound of its time below it."""
    placed = [s for s in plan.compared if len(points([s.sequence]))]
    compared = placed[:MAX_PARETO_PLANS]
    for k, record in enumerate(compared):
        point = points([record.sequence])
        look: Any = {"marker": "DsP^vX"[k % 6], "ls": "", "ms": 6, "mew": 0.5}
        look |= {"color": style.CYCLE[(k + 2) % len(style.CYCLE)], "mec": style.INK}
        axes.plot(*point.T, label=style.label(f"sequence {record.name}", 48), **look)
        if record.bound > 0.0:
            label = "bound of a sequence's time" if k == len(compared) - 1 else None
            dash: Any = {"color": style.INK, "ms": 10, "mew": 1.4}
            axes.plot(point[:, 0], [record.bound], "_", label=label, **dash)
