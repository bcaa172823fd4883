"""The certificate of the chosen readings: in words, in numbers, and refusals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from oed.design import CRITERIA
from oed.result import DesignSection
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Table,
    TableColumn,
    wide_column,
)

#: duality gap that is written as none
NO_GAP: Final = 1e-9


def blocks(design: DesignSection) -> list[Block]:
    """Sentence, numbers, refusals."""
    columns = [TableColumn("Quantity"), wide_column("Of the chosen readings")]
    rows = [[name, value] for name, value in _facts(design) if value]
    table = Table(columns, rows, _caption(design))
    return [Paragraph(sentence(design)), table, *_refusals(design)]


def sentence(design: DesignSection) -> str:
    """How good the choice is known to be."""
    if design.words:
        return text.sentence(design.words)
    readings = text.count(design.n, "reading")
    if design.candidates:
        readings += f" out of {text.count(design.candidates, 'candidate')}"
    if design.proven:
        return (
            f"Proven optimal: no other choice of {readings} is better by criterion"
            f" {design.criterion}."
        )
    if design.efficiency is not None:
        share = text.percent_at_least(design.efficiency)
        return f"Certified to {share} of the best possible {readings}."
    return (
        f"The best {readings} found by criterion {design.criterion}; no bound is known."
    )


def criterion_value(criterion: str, value: float | None) -> str:
    """A value of a criterion: logarithms with two decimals."""
    known = CRITERIA.entry(criterion)
    if known is not None and known.is_log_det:
        return text.fixed(value, 2)
    return text.number(value, 4)


# -- in numbers ------------------------------------------------------------------------


def _facts(design: DesignSection) -> Iterator[tuple[str, str]]:
    """Name and value of all that is stored; what is missing has an empty value."""
    criterion, setups = design.criterion, design.setups
    known = CRITERIA.entry(criterion)
    yield "Criterion", f"{criterion}: {known.meaning}" if known else criterion
    yield "Shares", _shares(design)
    yield "Value", criterion_value(criterion, design.value)
    yield "Bound", _bound(design)
    yield "Certificate", _certificate(design)
    yield "Duality gap", _duality_gap(design)
    yield "Directions determined", _directions(design)
    yield "Readings", _readings(design)
    yield "Candidates", str(design.candidates or "")
    yield "Set-ups, in working order", text.listing(setups, 20)
    yield "Cost", _cost(design)
    yield "Condition number", text.number(design.kappa, 4)
    yield "Scaling of the parameters", design.scaling


def _shares(design: DesignSection) -> str:
    """Shares of the criteria in a compound one."""
    total = sum(design.compound.values()) or 1.0
    return text.listing(
        f"{text.percent(weight / total)} {name}"
        for name, weight in design.compound.items()
    )


def _bound(design: DesignSection) -> str:
    if design.bound is None:
        return ""
    bound = criterion_value(design.criterion, design.bound)
    return f"{bound}: no choice is {_better(design)}"


def _better(design: DesignSection) -> str:
    known = CRITERIA.entry(design.criterion)
    return "smaller" if known is not None and known.smaller_is_better else "larger"


def _certificate(design: DesignSection) -> str:
    if design.proven:
        return "proven optimal"
    if design.efficiency is not None:
        share = text.percent_at_least(design.efficiency)
        return f"at least {share} of the best possible"
    polish = design.polished
    if polish is not None and polish.before != polish.after:
        return "only of the choice before polishing: the bound holds on the grid"
    return "no bound is known" if design.bound is None else ""


def _duality_gap(design: DesignSection) -> str:
    """How much of the distance to the bound may come from the bound itself."""
    gap = design.gap
    if gap is None:
        return ""
    if gap <= NO_GAP:
        return "none: weights on the candidates reach the bound"
    return f"the bound may be up to {text.percent(math.expm1(gap))} too high"


def _directions(design: DesignSection) -> str:
    if not design.directions or not design.columns:
        return ""
    return f"{design.directions} of {design.columns}"


def _readings(design: DesignSection) -> str:
    if not design.retained:
        return str(design.n)
    return f"{design.n}, of which {design.retained} belong to the earlier plan"


def _cost(design: DesignSection) -> str:
    if design.cost_min is None:
        return ""
    return f"{text.quantity(design.cost_min, 'min')} for mounting and reading"


def _caption(design: DesignSection) -> str:
    """Value and bound once more: what one compares first."""
    criterion = design.criterion
    value = criterion_value(criterion, design.value)
    caption = f"The choice in numbers: by criterion {criterion} it reaches {value}"
    if design.effects is not None:
        caption += " with the effects that it allows for"
    if design.bound is None:
        return f"{caption}."
    bound = criterion_value(criterion, design.bound)
    return f"{caption}, and the best possible is no {_better(design)} than {bound}."


# -- refusals --------------------------------------------------------------------------


def _refusals(design: DesignSection) -> list[Block]:
    """Why candidates were left out, most refusals first."""
    refused = sorted(design.refused.items(), key=lambda item: -item[1])
    if not refused:
        return []
    reason, count = refused[0]
    candidates, reason = text.count(count, "candidate"), text.replace_symbols(reason)
    if len(refused) == 1:
        verb = "was" if count == 1 else "were"
        return [
            Paragraph(
                f"{candidates} {verb} left out before the choice, because they {reason}."
            )
        ]
    columns = [TableColumn("Candidates", number=True), wide_column("which …")]
    rows = [[str(n), text.replace_symbols(why)] for why, n in refused]
    caption = (
        "Candidates left out before the choice; one may have several reasons. Most,"
        f" {count}, {reason}."
    )
    return [Table(columns, rows, caption)]
