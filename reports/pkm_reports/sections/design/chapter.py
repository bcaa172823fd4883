"""Chapter: how good the plan is: its certificate, and comparisons with other plans."""

from __future__ import annotations

import math
from typing import Final

from oed.result import DesignSection, HowManySummary, RobustSummary, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_columns,
    wide_column,
)
from pkm_reports.missing import or_nan
from pkm_reports.sections import recording
from pkm_reports.sections.design import certificate, criteria, plans
from pkm_reports.sections.design.certificate import criterion_value
from pkm_reports.sections.figures import how_many, robust


def blocks(result: StudyResult) -> list[Block]:
    """Certificate, polishing, reference plans, criteria, effects, scenarios, number of readings."""
    design = result.design
    if design is None:
        return []
    return [
        *certificate.blocks(design),
        *_polish(design),
        *plans.blocks(design),
        *criteria.blocks(design),
        *_effects(design),
        *_robust(design),
        *_how_many(design),
    ]


CHAPTER: Final = Chapter("design", "How good the plan is", blocks)


# -- poses and set-ups polished off the grid -------------------------------------------


def _polish(design: DesignSection) -> list[Block]:
    """Criterion before and after, and the set-ups that moved."""
    polish = design.polished
    if polish is None:
        return []
    criterion = design.criterion
    before = criterion_value(criterion, polish.before)
    after = criterion_value(criterion, polish.after)
    sentence = f"Polishing off the grid brings criterion {criterion}"
    sentence += f" from {before} to {after}"
    if polish.before == polish.after:
        sentence = f"Polishing off the grid leaves criterion {criterion} at {after}"
    if polish.words and polish.words not in design.words:
        sentence += f": {polish.words}"
    content: list[Block] = [Paragraph(text.sentence(sentence))]
    if polish.setups:
        columns = [TableColumn("Set-up"), wide_column("Set it to")]
        rows = [
            [name, text.named_quantities(settings)]
            for name, settings in polish.setups.items()
        ]
        count = text.count(len(rows), "set-up")
        caption = f"New settings of the set-ups that polishing moved: {count}."
        content.append(Table(columns, rows, caption))
    return content


# -- the plan that allows for effects, beside one for a machine without ----------------


def _effects(design: DesignSection) -> list[Block]:
    """A sentence, and the accuracy of both plans."""
    allowed = design.effects
    if allowed is None:
        return []
    with_effects = _difference(allowed.efficiency)
    alone = _difference(allowed.efficiency_without)
    sentence = (
        f"The plan allows for {text.count(allowed.groups, 'group')} of effects beside the"
        f" geometry, {_sizes(allowed.size)}. On a machine that has them at the sizes expected"
        f" of them, the plan for a machine without effects {with_effects} by"
        f" {design.criterion}; on a machine without effects, this plan {alone}."
    )
    columns = [
        wide_column("Error after compensation, rms"),
        *number_columns("before any reading", "this plan", "plan without effects"),
    ]
    rows = []
    for key, value in allowed.accuracy.items():
        stem, unit = text.split_unit(key)
        values = (allowed.before[key], value, allowed.accuracy_without[key])
        rows.append([stem, *(text.quantity(v, unit) for v in values)])
    caption = (
        "Predicted errors over the workspace of a machine with these effects, once all that"
        " is known is corrected."
    )
    table = Table(columns, rows, caption)
    return [Paragraph(sentence), table, *recording.blocks(allowed.recording)]


def _difference(efficiency: float) -> str:
    """What a plan loses, or gains, against another one."""
    verb = "loses" if efficiency <= 1.0 else "gains"
    return f"{verb} {text.percent(abs(1.0 - efficiency))}"


def _sizes(factor: float) -> str:
    """The sizes that the plan is chosen for, as a factor on the expected ones."""
    if factor == 1.0:
        return "at the sizes expected of them"
    return (
        f"at {factor:.2g} times the sizes expected of them, the typical size on a healthy"
        " machine"
    )


# -- the robust plan over many machines and set-ups ------------------------------------


RISKS: Final = {"mean": "the mean over all", "worst": "the worst"}


def _robust(design: DesignSection) -> list[Block]:
    """A sentence, and the scenarios of both plans."""
    summary = design.robust
    if summary is None:
        return []
    caption = _robust_caption(summary)
    return [
        Paragraph(_robust_sentence(summary)),
        Picture("robust", lambda: robust.draw(summary), caption),
    ]


def _robust_sentence(summary: RobustSummary) -> str:
    scenarios = text.count(summary.scenarios, "scenario")
    gain = text.times(math.exp(summary.value - summary.nominal))
    share = text.percent_at_least(summary.efficiency)
    return (
        f"The plan is robust: it is judged by {_risk(summary)} of {scenarios}, machines"
        " and set-ups drawn within what is known of them beforehand. By that risk it is"
        f" worth {gain} the plan for the nominal machine, and is certified to {share} of"
        " the best possible."
    )


def _risk(summary: RobustSummary) -> str:
    if summary.risk == "cvar":
        return f"the mean of the worst {text.percent(summary.level)}"
    return text.meaning(summary.risk, RISKS)


def _robust_caption(summary: RobustSummary) -> str:
    """In how many scenarios the robust plan is ahead."""
    caption = (
        "Worth of the robust and of the nominal plan in each scenario, exp(value −"
        " largest value of all), worst first. Dashed: by the risk of the study. Right"
        " is better."
    )
    pairs = list(zip(summary.values, summary.nominal_values, strict=False))
    if not pairs:
        return caption
    ahead = sum(or_nan(value) > or_nan(nominal) for value, nominal in pairs)
    return f"{caption} The robust plan is ahead in {ahead} of {len(pairs)}."


# -- how many readings a wanted accuracy needs -----------------------------------------


def _how_many(design: DesignSection) -> list[Block]:
    """A sentence, and accuracy over the number of readings."""
    summary = design.how_many
    if summary is None:
        return []
    caption = _how_many_caption(summary)
    return [
        Paragraph(_how_many_sentence(summary)),
        Picture("how_many", lambda: how_many.draw(summary), caption),
    ]


def _how_many_sentence(summary: HowManySummary) -> str:
    """The sentence of the study, or the same from the numbers."""
    wanted = text.named_quantities(summary.wanted, 4)
    if summary.words:
        verdict = text.sentence(summary.words)
        return f"Wanted: {wanted}. {verdict}" if summary.wanted else verdict
    if not summary.wanted:
        return (
            "The study asks for no accuracy: the figure shows what each number of"
            " readings reaches."
        )
    if summary.fewest is None:
        return (
            f"No plan found with up to {summary.most} readings reaches {wanted}; none"
            f" with fewer than {summary.at_least} can."
        )
    readings = text.count(summary.fewest, "reading")
    if summary.fewest == summary.at_least:
        return f"A plan of {readings} reaches {wanted}; fewer cannot (proven)."
    return (
        f"A plan of {readings} reaches {wanted}; fewer than {summary.at_least} readings"
        " cannot."
    )


def _how_many_caption(summary: HowManySummary) -> str:
    """First and last point of each curve."""
    caption = (
        "Predicted rms error over the number of readings, both on log scales. Dots are"
        " plans found; no plan of as many readings lies in the shaded region."
    )
    sizes = summary.sizes
    ranges = []
    for key, values in summary.accuracy.items():
        if len(values) == len(sizes) > 1:
            stem, unit = text.split_unit(key)
            first, last = (
                text.quantity(values[0], unit),
                text.quantity(values[-1], unit),
            )
            ranges.append(f"{stem} from {first} to {last}")
    if not ranges:
        return caption
    return f"{caption} From {sizes[0]} to {sizes[-1]} readings: {text.listing(ranges)}."
