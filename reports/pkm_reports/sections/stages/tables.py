"""Tables of a plan stage by stage: schedule, improved parameters, accuracy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from oed.result import MachineInfo, PlanSection, Sd, StageRecord
from oed.text import shorten
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Table,
    TableColumn,
    number_columns,
    transposed,
    wide_column,
)
from pkm_reports.sections.figures import stage_accuracy
from pkm_reports.sections.stages import verdict, wording

#: parameters named for each stage, those that improve most
MOST_PARAMETERS: Final = 4
#: parameters and combinations named that are not yet determined
MOST_UNDETERMINED: Final = 8
#: factor below which a standard deviation counts as unchanged by a stage
IMPROVED: Final = 1.05
#: characters of a combination of parameters; longer ones are cut
LONGEST: Final = 56
#: expected losses that are written as none
NO_LOSS: Final = 0.005


# -- schedule --------------------------------------------------------------------------


def schedule(plan: PlanSection) -> Table:
    """The stages in order: when, what, how many readings, what they determine."""
    stages = plan.stages
    columns = number_columns("Stage", "Minutes")
    columns += [wide_column("Measurement"), wide_column("Set-ups")]
    cells = [
        [str(k) for k in range(1, len(stages) + 1)],
        [_span(stage) for stage in stages],
        [stage.measurement for stage in stages],
        [text.listing(stage.setups) for stage in stages],
    ]
    if any(stage.operator for stage in stages):
        columns.append(TableColumn("Operator"))
        cells.append([stage.operator or text.MISSING for stage in stages])
    columns += number_columns("Readings", "Expected lost", "Rank alone", "Rank so far")
    cells += [
        [str(stage.readings) for stage in stages],
        [_lost(stage) for stage in stages],
        [str(stage.identifies) for stage in stages],
        [text.MISSING if s.rank is None else str(s.rank) for s in stages],
    ]
    if any(stage.price for stage in stages):
        columns += number_columns("Price")
        cells.append([text.trimmed(stage.price) for stage in stages])
    return Table(columns, transposed(cells), _schedule_caption(plan))


def _span(stage: StageRecord) -> str:
    begin, end = text.trimmed(stage.begin_min, 3), text.trimmed(stage.end_min, 3)
    return f"{begin}–{end}"


def _lost(stage: StageRecord) -> str:
    if stage.lost is None:
        return text.MISSING
    lost = "0" if stage.lost < NO_LOSS else text.trimmed(stage.lost, 2)
    return f"{lost} of {stage.chosen}" if stage.chosen else lost


def _schedule_caption(plan: PlanSection) -> str:
    cost, budget = wording.minutes(plan.cost), wording.budget_share(plan)
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


# -- parameters ------------------------------------------------------------------------


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
                text.listing(undetermined, MOST_UNDETERMINED) or "nothing",
            ]
        )
        before = after
    columns = [
        TableColumn("Stage", number=True),
        TableColumn("Measurement"),
        wide_column("Improved most"),
        wide_column("Not yet determined"),
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
    best = sorted(factors, key=lambda name: -factors[name])[:MOST_PARAMETERS]
    entries = [_improvement(name, after[name], factors[name]) for name in best]
    more = len(factors) - len(best)
    return ", ".join(entries) + (f" and {more} more" if more else "")


def _is_improved(before: Sd, after: Sd) -> bool:
    same_unit = before.unit == after.unit
    return same_unit and after.sd > 0.0 and before.sd > IMPROVED * after.sd


def _improvement(name: str, after: Sd, factor: float) -> str:
    sd = text.quantity(after.sd, after.unit, 2)
    return f"{name} {sd} ({text.number(factor, 2)}×)"


def shorten_combination(combination: str) -> str:
    """A combination of parameters, a long one without its last terms."""
    if len(combination) <= LONGEST:
        return combination
    opening = combination[: LONGEST + 1]
    if " " not in opening:
        return shorten(opening, LONGEST)
    last_term = max(opening.rfind(" + "), opening.rfind(" - "))
    return f"{opening[:last_term]} ..."


# -- accuracy --------------------------------------------------------------------------


def accuracies(plan: PlanSection) -> Table:
    """Accuracy before, after each stage and as wanted; virtual machines below each."""
    keys = stage_accuracy.components(plan)
    start = "before" if plan.after else "before any reading"
    rows = [[start, *wording.cells(plan.start_accuracy, keys)]]
    marks = [""]
    for k, stage in enumerate(plan.stages, 1):
        mark = "chosen" if k == len(plan.stages) else ""
        rows.append([f"after stage {k}", *wording.cells(stage.accuracy, keys)])
        marks.append(mark)
        reached = stage_accuracy.realised(stage)
        if reached:
            label = "… realised, virtual machines"
            rows.append([label, *wording.cells(reached, keys)])
            marks.append(mark)
    if plan.goal:
        rows.append(["wanted", *wording.cells(plan.goal, keys)])
        marks.append("")
    if verdict.is_missed(plan):
        label = "most accurate plan found"
        rows.append([label, *wording.cells(plan.best_reachable, keys)])
        marks.append("")
    titles = [text.heading(key) for key in keys]
    columns = [wide_column("When"), *number_columns(*titles)]
    caption = "Accuracy of each component, rms over the workspace, stage by stage."
    return Table(columns, rows, caption, marks)
