"""Whether the plan reaches its goal, how close to the best it is, when to stop."""

from __future__ import annotations

from oed.result import PlanSection
from pkm_reports import text
from pkm_reports.blocks import Block, Notice, Paragraph, headed_list
from pkm_reports.sections.stages import wording


def blocks(plan: PlanSection) -> list[Block]:
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


def is_missed(plan: PlanSection) -> bool:
    """Whether there is a goal that the plan does not reach."""
    return bool(plan.goal) and not plan.reached


def _missed(plan: PlanSection) -> str:
    goal, within = wording.accuracies(plan.goal), wording.budget_phrase(plan)
    notice = f"The goal is out of reach{within}: {goal}."
    best = wording.accuracies(plan.best_reachable, plan.goal)
    if not best:
        return notice
    return f"{notice} The most accurate plan found reaches {best}."


def _reached(plan: PlanSection) -> str:
    stages = text.count(len(plan.stages), "stage")
    costs = f"{wording.minutes(plan.cost)}{wording.budget_share(plan)}"
    if plan.price:
        costs += f", at a price of {text.trimmed(plan.price)}"
    content = f"has {stages} and takes {costs}."
    accuracy = wording.accuracies(plan.accuracy)
    if accuracy:
        content += f" It reaches {accuracy} (rms over the workspace)."
    if plan.goal:
        goal = wording.accuracies(plan.goal)
        return f"The goal ({goal}) is reached. The least costly plan found {content}"
    return f"The most accurate plan found {content}"


def _bound(plan: PlanSection, bound: float) -> str:
    """How far the plan can be from the best one."""
    value, subject = "the remaining share of the error", "this plan"
    if plan.goal:
        value = "the worst ratio of error to wanted accuracy"
        subject = "the most accurate plan found"
    within = wording.budget_phrase(plan)
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
