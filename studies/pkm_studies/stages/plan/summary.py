"""The plan in headline sentences."""

from __future__ import annotations

from oed import result
from pkm_studies.stages.plan.phrases import accuracies, at_most_better


def plan_sentences(section: result.PlanSection | None) -> list[str]:
    """The plan as headline sentences; none where it was not searched for."""
    if section is None or section.value is None or not section.stages:
        return []
    names = ", then ".join(f"{s.measurement} ({s.chosen})" for s in section.stages)
    lines = [
        f"Plan of {section.cost:.0f} min: {names}; it leaves"
        f" {accuracies(section.accuracy)} rms over the workspace."
    ]
    if section.goal and section.reached:
        lines.append("The target accuracy is reached.")
    elif section.goal:
        lines.append(" ".join(section.needs))
    if section.loss is not None:
        lines.append(
            f"No plan within {section.budget_min:.0f} min is more than"
            f" {at_most_better(section.loss)}: a bound over all plans that take each"
            " measurement at most as often as `counts` allows."
        )
    return lines
