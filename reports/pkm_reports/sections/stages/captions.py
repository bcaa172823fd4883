"""Captions of the figures of a plan in stages."""

from __future__ import annotations

from oed.result import PlanSection
from pkm_reports.figures import pareto
from pkm_reports.page import text
from pkm_reports.sections.stages import wording

#: minutes below which no time is said to remain
NO_TIME: float = 0.5


def accuracy(plan: PlanSection) -> str:
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


def schedule(plan: PlanSection) -> str:
    """How long the plan takes, and how much of the budget remains."""
    cost, budget = wording.minutes(plan.cost), wording.of_budget(plan)
    caption = f"The stages over time: {cost}{budget}."
    if plan.budget_min is None or plan.budget_min - plan.cost <= NO_TIME:
        return caption
    return f"{caption} {wording.minutes(plan.budget_min - plan.cost)} remain."


def front(plan: PlanSection) -> str:
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
