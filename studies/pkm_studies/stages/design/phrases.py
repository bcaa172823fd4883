"""A design in sentences: what its readings reach, and on a machine with effects."""

from __future__ import annotations

from oed.design import CRITERIA
from oed.result import DesignSection, PlanScore
from oed.text import format_number, guaranteed_percent


def gain_sentences(section: DesignSection | None) -> list[str]:
    """How much more accurate the machine becomes than with the first reference plan."""
    if section is None or len(section.plans) < 2 or not section.plans[0].gain:
        return []
    gains, reference = section.plans[0].gain.values(), section.plans[1]
    readings = f"{section.n} readings in {', '.join(section.setups)}"
    return [
        f"With the {readings}, the pose is {min(gains):.2g} to {max(gains):.2g} times as"
        f" accurate as with {reference.name}."
    ]


def design_sentences(section: DesignSection | None) -> list[str]:
    """What the readings reach by the criterion, beside the reference plans.

    Reference plans are judged without effects, as the chosen one is beside them.
    """
    if section is None:
        return []
    criterion = section.criterion
    reached = _value(criterion, section.value)
    if section.effects is not None:
        alone = _value(criterion, section.plans[0].value)
        reached += f" with effects{_proof(section)}, and without any {alone}"
    else:
        reached += _proof(section)
    others = [_other_plan(plan, criterion) for plan in section.plans[1:]]
    against = f", against {'; '.join(others)}" if others else ""
    return [
        f"The {criterion}-optimal {section.n} readings reach {reached}{against};"
        f" the condition number is {format_number(section.kappa)}"
        f" ({section.scaling} scaling).",
    ]


def _value(criterion: str, value: float) -> str:
    """What a plan reaches by a criterion."""
    label = _label(criterion)
    if label:
        return f"{label} {value:.2f}"
    return f"{criterion} = {format_number(value)}"


def _label(criterion: str) -> str:
    """What the criterion's number is called; empty where by the criterion's name."""
    known = CRITERIA.entry(criterion)
    return "" if known is None else known.label


def _proof(section: DesignSection) -> str:
    """How far from the best possible the choice may be."""
    if section.proven:
        return " (proven optimal)"
    if section.efficiency is None:
        return ""
    share = guaranteed_percent(section.efficiency)
    return f" (certified to {share:.1f} % of the best possible)"


def effects_sentences(section: DesignSection | None) -> list[str]:
    """What the plan reaches on a machine with effects, beside the plan without them."""
    allowed = None if section is None else section.effects
    if allowed is None:
        return []
    parts = []
    for key, value in allowed.accuracy.items():
        name, _, unit = key.rpartition("_")
        other = allowed.accuracy_without[key]
        parts.append(f"{name} {value:.3g} ({other:.3g}) {unit}")
    return [
        f"The plan allows for {allowed.groups} groups of effects. With these at the sizes expected"
        " of them it leaves rms errors, in brackets those of the plan for a machine without"
        f" effects: {', '.join(parts)}.",
    ]


def _other_plan(plan: PlanScore, criterion: str) -> str:
    by_log_det = bool(_label(criterion))
    value = f"{plan.logdet:.2f}" if by_log_det else format_number(plan.value)
    share = f"{100 * plan.efficiency:.0f} % {criterion}-efficiency"
    return f"{value} for {plan.name} ({share})"
