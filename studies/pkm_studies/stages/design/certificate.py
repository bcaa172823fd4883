"""States in one or two sentences how good the chosen plan is known to be."""

from __future__ import annotations

import numpy as np

from oed.result import RobustSummary
from pkm_studies.stages.design.select import ChosenDesign
from pkm_studies.stages.headline import percent_rounded_down

#: slack of the bound (log of an efficiency) from which it is worth saying
SLACK = 0.01


def certificate_text(chosen: ChosenDesign, shared: int = 0) -> str:
    """The certificate, its scope, and what polishing added.

    `shared` columns stand for the common errors of runs and are not counted.
    """
    kind = "runs" if chosen.criteria.table.whole_runs else "readings"
    what = f"{len(chosen.choice.indices)} of {chosen.candidates} {kind}"
    text = _certificate(chosen, what)
    text += _directions(chosen, shared)
    text += _shortfall(chosen)
    if chosen.relaxed is not None:
        text += ": the largest of the relaxation's weights"
    if chosen.retained:
        text += f", added to {chosen.retained} retained readings"
    polish = chosen.polish
    if polish is None:
        return f"{text}."
    return f"{text}. Then, off the grid, {polish.words}."


def _certificate(chosen: ChosenDesign, what: str) -> str:
    choice = chosen.choice
    if chosen.robust is not None:
        return _robust_certificate(chosen.robust, what)
    if choice.proven:
        return (
            f"Proven optimal: no other choice of {what} is better by {choice.criterion}"
        )
    if choice.efficiency is None:
        return (
            f"The best choice of {what} that the search found; no bound is known for"
            f" {choice.criterion} under these rules"
        )
    share = percent_rounded_down(choice.efficiency)
    text = f"Certified to {share} % of the best possible choice of {what}"
    if chosen.bound_ignores_setups:
        text += (
            " (the bound allows any number of set-ups: the choice is better than this"
            " figure)"
        )
    elif choice.duality_gap is not None and choice.duality_gap > SLACK:
        text += (
            f" (the bound itself may be {100 * choice.duality_gap:.0f} % too high: the choice"
            " is better than this figure)"
        )
    return text


def _directions(chosen: ChosenDesign, shared: int) -> str:
    """The scope, where the candidates do not see all parameters."""
    visible = chosen.choice.directions - shared
    columns = chosen.choice.columns - shared
    if visible >= columns:
        return ""
    text = (
        f", over the {visible} of {columns} directions that the candidates see (the"
        " identifiable subspace)"
    )
    if chosen.choice.weak:
        text += (
            f"; {chosen.choice.weak} of the directions left out are seen, but at least a"
            " million times worse than the best one: they count as not seen"
        )
    return text


def _shortfall(chosen: ChosenDesign) -> str:
    """A remark where the rules do not allow as many readings as the study asks for."""
    table, count = chosen.criteria.table, len(chosen.choice.indices)
    wanted = table.size
    if wanted is None or count >= wanted or table.budget_min is not None:
        return ""
    return f"; the study asks for {wanted}, but the rules leave no room for more"


def _robust_certificate(robust: RobustSummary, what: str) -> str:
    risk = {
        "mean": "on average",
        "cvar": f"over the worst {percent_rounded_down(robust.level)} %",
        "worst": "for the worst one",
    }
    share = percent_rounded_down(robust.efficiency)
    gain = 100.0 * (np.exp(robust.value - robust.nominal) - 1.0)
    return (
        f"Chosen for {robust.scenarios} machines drawn from the tolerances,"
        f" {risk[robust.risk]}: certified to {share} % of the best possible choice of"
        f" {what} for them, and {gain:.1f} % better there than the plan for the nominal"
        " machine"
    )
