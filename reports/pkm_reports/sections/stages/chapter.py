"""Chapter: which measurement at which stage, and why this plan.

Only plans with a schedule have it: their stages have times (`begin_min`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import AlternativePlan, PlanSection, SequenceRecord, StudyResult
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Items,
    Paragraph,
    Picture,
    Table,
    headed_list,
    number_columns,
    transposed,
    wide_column,
)
from pkm_reports.sections import recording
from pkm_reports.sections.figures import pareto, stage_accuracy, timeline
from pkm_reports.sections.stages import tables, verdict, wording


def has_schedule(plan: PlanSection | None) -> bool:
    """Whether a plan has times of its stages."""
    return plan is not None and any(s.begin_min is not None for s in plan.stages)


def blocks(result: StudyResult) -> list[Block]:
    """Verdict, stages, accuracy and time, alternatives, sequences of the study."""
    plan = result.plan
    if plan is None or not has_schedule(plan):
        return []
    return [
        *verdict.blocks(plan),
        tables.schedule(plan),
        tables.improvements(plan, result.machine),
        tables.accuracies(plan),
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
    return [tables.schedule(plan), tables.accuracies(plan)]


def _pictures(plan: PlanSection) -> list[Block]:
    return [
        Picture(
            "plan_stages", lambda: stage_accuracy.draw(plan), _accuracy_caption(plan)
        ),
        Picture("plan_timeline", lambda: timeline.draw(plan), _schedule_caption(plan)),
        Picture("plan_front", lambda: pareto.draw(plan), _front_caption(plan)),
    ]


CHAPTER: Final = Chapter("stages", "Which measurement at which stage", blocks, printed)


# -- the plan that allows for effects, beside one for a machine without ----------------


def _effects(plan: PlanSection) -> list[Block]:
    """A sentence, and the accuracy that each plan promises and reaches."""
    allowed = plan.effects
    if allowed is None:
        return []
    columns = [
        wide_column("Error after compensation, rms"),
        *number_columns(
            "promised without effects", "that plan with effects", "this plan"
        ),
    ]
    rows = []
    for key, promised in allowed.promised.items():
        stem, unit = text.split_unit(key)
        values = (promised, allowed.without.accuracy[key], plan.accuracy[key])
        rows.append([stem, *(text.quantity(v, unit) for v in values)])
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
    table = Table(columns, rows, caption)
    return [Paragraph(sentence), table, *recording.blocks(allowed.recording)]


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
        " predicted ones.",
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
    """A table of plans, and the alternatives that are stored as sentences."""
    described = [entry for entry in plan.alternatives if isinstance(entry, str)]
    sentences = headed_list("Alternatives considered:", text.sentences(described))
    others = pareto.alternatives(plan)
    if not others:
        return sentences
    columns = [
        wide_column("Plan (readings or runs)"),
        *number_columns("Minutes", "Value"),
        wide_column("Why not"),
    ]
    rows = [
        [
            wording.measurements(other),
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
    cost, of_plan = wording.minutes(plan.cost), text.number(plan.value)
    caption = (
        f"Plans that were considered and not taken. Value: {value}, smaller is better."
        f" The plan itself: {cost}, value {of_plan}."
    )
    return [Table(columns, rows, caption), *sentences]


# -- captions --------------------------------------------------------------------------


#: minutes below which no time is said to remain
NO_TIME: float = 0.5


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
    cost, budget = wording.minutes(plan.cost), wording.budget_share(plan)
    caption = f"The stages over time: {cost}{budget}."
    if plan.budget_min is None or plan.budget_min - plan.cost <= NO_TIME:
        return caption
    return f"{caption} {wording.minutes(plan.budget_min - plan.cost)} remain."


def _front_caption(plan: PlanSection) -> str:
    """What more time buys."""
    sentences = ["The value of plans against the time that they take."]
    if plan.front:
        sentences.append(
            "No plan found is both shorter and more accurate than a plan on the line."
        )
    if plan.bound is not None:
        sentences.append("No plan within the budget lies in the shaded region.")
    points = pareto.points(plan.front)
    if len(points) > 1:
        (first, start), (last, end) = points[0], points[-1]
        sentences.append(
            f"From {wording.minutes(first)} to {wording.minutes(last)} the value falls"
            f" from {text.number(start)} to {text.number(end)}."
        )
    more = len(plan.compared) - pareto.MOST
    if more > 0:
        sentences.append(f"{more} more sequences are in the table only.")
    return " ".join(sentences)


# -- sequences that the study asks for -------------------------------------------------


def sequences(plan: PlanSection) -> list[Block]:
    """What the sequences determine, how they compare, and what follows from it."""
    compared = plan.compared
    if not compared:
        return []
    content: list[Block] = [_ranks(compared), _comparison(compared)]
    sentences = [f"{s.name}: {text.sentence(s.words)}" for s in compared if s.words]
    if sentences:
        content.append(Items(sentences))
    return content


def _ranks(compared: Sequence[SequenceRecord]) -> Table:
    indices = list(dict.fromkeys(key for s in compared for key in s.observability))
    columns = [
        wide_column("Sequence"),
        *number_columns("Readings", "Minutes", "Rank", "κ", "Weakest"),
        *number_columns(*indices, "Lost"),
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


def _comparison(compared: Sequence[SequenceRecord]) -> Table:
    """Three rows for each sequence: itself, the best plan of its time, the gain."""
    plans = [plan for s in compared for plan in (s.sequence, s.plan)]
    keys = list(dict.fromkeys(key for plan in plans for key in plan.accuracy))
    rows, marks = [], []
    for record in compared:
        best = wording.measurements(record.plan)
        rows.append(_row(record.name, record.sequence, "", keys))
        rows.append(_row(best, record.plan, text.number(record.bound), keys))
        marks += ["", "chosen"]
        if record.gain:
            factors = [
                text.times(stage_accuracy.component_label(record.gain, key))
                for key in keys
            ]
            rows.append(["… times as accurate", "", "", "", *factors])
            marks.append("chosen")
    columns = [
        wide_column("Sequence"),
        *number_columns("Minutes", "Value", "Bound"),
        *number_columns(*[text.heading(key) for key in keys]),
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
    return [*head, *wording.cells(plan.accuracy, keys)]
