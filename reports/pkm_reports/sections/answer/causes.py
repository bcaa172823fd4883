"""After a diagnosis: ranked causes, what remains, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from oed.result import CorrectedSection, EffectEstimate, GapSection, StudyResult
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Table,
    TableColumn,
    headed_list,
    number_columns,
    wide_column,
)
from pkm_reports.sections.figures.gap import effects
from pkm_reports.sections.figures.gap.effects import spoken
from pkm_reports.sections.gap import explanations

#: causes that are listed, and coefficients that stand for the size of one
MOST: Final = 5
MOST_COEFFICIENTS: Final = 3
#: probability below which an effect that is not selected is no cause to list
UNLIKELY: Final = 0.05
#: standard deviations from which a coefficient counts as a size
CLEAR: Final = 2.0


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    return "What causes the error"


def blocks(result: StudyResult) -> list[Block]:
    """Causes by size, what remains, what to do next."""
    gap = result.gap
    if gap is None:
        return []
    content: list[Block] = []
    ranked = _ranked(gap)
    if ranked:
        content.append(_table(gap, ranked, result.corrected))
    remaining = _remains(gap)
    if remaining:
        content.append(Paragraph(remaining))
    actions = text.sentences(gap.next)
    if gap.closure and not actions:
        actions = ["Nothing: no effect needs a remedy."]
    return [*content, *headed_list("What to do:", actions)]


def _ranked(gap: GapSection) -> list[str]:
    """Selected effects by their size, then others that are not unlikely."""
    sizes = {size.effect: sum(v * v for v in size.rms.values()) for size in gap.sizes}
    selected = sorted(gap.selected, key=lambda n: -sizes[n] if n in sizes else 0.0)
    others = [
        name
        for name in sorted(gap.marginal, key=lambda n: -gap.marginal[n])
        if name not in gap.selected and gap.marginal[name] >= UNLIKELY
    ]
    return [*selected, *others][:MOST]


def _table(
    gap: GapSection, ranked: Sequence[str], corrected: CorrectedSection | None
) -> Table:
    columns = [
        TableColumn("Cause"),
        *number_columns("Probability"),
        # of one channel a number, of six a list
        wide_column("In the readings, rms"),
        wide_column("After calibration, rms"),
        wide_column("Size of its own"),
    ]
    sizes = {size.effect: size for size in gap.sizes}
    rows = []
    for name in ranked:
        rms = remaining = ""
        if name in sizes:
            rms = explanations.size_in_readings(gap, sizes[name].rms)
            remaining = explanations.size_in_readings(gap, sizes[name].remaining)
        chance = missing.entry(gap.marginal, name)
        rows.append(
            [
                "an effect of unknown form" if name == "unknown" else spoken(name),
                _probability(chance),
                rms or text.MISSING,
                remaining or text.MISSING,
                own_size(name, corrected) or text.MISSING,
            ]
        )
    caption = (
        "Causes by their size in the readings, what calibration leaves of it, and the"
        " probability that each acts. Size of its own: its clearest coefficients with"
        " standard deviations."
    )
    marks = ["chosen" if name in gap.selected else "" for name in ranked]
    return Table(columns, rows, caption, marks)


def _probability(chance: float) -> str:
    """In percent; never certainty."""
    if chance > effects.NEARLY_CERTAIN:
        return f"> {text.percent(effects.NEARLY_CERTAIN)}"
    return text.percent(chance)


def own_size(effect: str, corrected: CorrectedSection | None) -> str:
    """The clearest coefficients of an effect in its own unit: leg 3 6.00 ± 0.04 µm."""
    if corrected is None:
        return ""
    clear = {
        name.partition(": ")[2]: e
        for name, e in corrected.effects.items()
        if e.effect == effect and abs(e.value) > CLEAR * e.sd and not e.shape
    }
    order = sorted(clear, key=lambda name: -abs(clear[name].value))
    phrases = [_coefficient(name, clear[name]) for name in order[:MOST_COEFFICIENTS]]
    if len(order) > MOST_COEFFICIENTS:
        phrases.append(
            text.count(len(order) - MOST_COEFFICIENTS, "smaller coefficient")
        )
    return text.listing(phrases)


def _coefficient(name: str, estimate: EffectEstimate) -> str:
    decimals = text.decimals_for(estimate.sd)
    value, sd = text.fixed(estimate.value, decimals), text.fixed(estimate.sd, decimals)
    return f"{name} {text.append_unit(f'{value} ± {sd}', estimate.unit)}"


def _remains(gap: GapSection) -> str:
    """The rms residual before and after, and what the noise is."""
    if not gap.rms_before:
        return ""
    if not gap.selected:
        sizes = [
            f"{name} {text.channel_value(name, rms, gap.units)}"
            for name, rms in gap.rms_before.items()
        ]
        phrase = f"What calibration leaves, rms: {'; '.join(sizes)}."
        return " ".join([phrase, *text.sentences(gap.noise)])
    parts = []
    for name, before in gap.rms_before.items():
        after = missing.entry(gap.rms_after, name)
        change = (
            f"{name} {text.channel_value(name, before, gap.units)} before,"
            f" {text.channel_value(name, after, gap.units)} after"
        )
        parts.append(change)
    phrase = f"What remains with these causes in the model, rms: {'; '.join(parts)}."
    return " ".join([phrase, *text.sentences(gap.noise)])
