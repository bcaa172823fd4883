"""The robust plan over many machines and set-ups, against the nominal plan."""

from __future__ import annotations

import math
from typing import Final

from oed.result import DesignSection, RobustSummary
from pkm_reports.figures import robust
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Paragraph, Picture
from pkm_reports.page.missing import or_nan

RISKS: Final = {"mean": "the mean over all", "worst": "the worst"}


def blocks(design: DesignSection) -> list[Block]:
    """A sentence, and the scenarios of both plans."""
    summary = design.robust
    if summary is None:
        return []
    caption = _caption(summary)
    return [
        Paragraph(_sentence(summary)),
        Picture("robust", lambda: robust.draw(summary), caption),
    ]


def _sentence(summary: RobustSummary) -> str:
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


def _caption(summary: RobustSummary) -> str:
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
