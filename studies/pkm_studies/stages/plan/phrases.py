"""Phrases about plans: shares, factors and differences of time."""

from __future__ import annotations

from collections.abc import Mapping

from oed import result, units


def percent(share: float) -> str:
    """A share in percent, with one decimal below 10 %."""
    return f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.1f} %"


def more_accurate(value: float, better: float) -> str:
    """How much more accurate `better` is than `value`: a share, or a factor from 2."""
    ratio = value / better
    if ratio >= 2.0:
        return f"{ratio:.3g} times as accurate"
    return f"{percent(ratio - 1.0)} more accurate"


def loss_bound_text(loss: float) -> str:
    """How much better than a plan the best possible one can be, given the loss."""
    if loss < 1.0:
        return f"{percent(loss)} better"
    return f"{loss + 1.0:.3g} times as accurate"


def minutes(seconds: float) -> str:
    """A time in whole minutes."""
    return f"{units.number(seconds, 'min'):.0f} min"


def time_difference(seconds: float, other: float) -> str:
    """How much longer or shorter a time is than another one, s."""
    difference = abs(seconds - other)
    if difference < 0.02 * other:
        return "in the same time"
    return f"in {minutes(difference)} {'less' if seconds < other else 'more'}"


def accuracies(values: Mapping[str, float]) -> str:
    """Accuracies by component and unit (`z_um`), as a list."""
    parts = []
    for key, value in values.items():
        component, _, unit = key.rpartition("_")
        parts.append(f"{component} {value:.3g} {unit}")
    return "; ".join(parts)


# -- the plan in headline sentences ----------------------------------------------------


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
    lines += bound_sentences(section)
    if section.effects is not None:
        lines.append(section.effects.words)
    return lines


def bound_sentences(section: result.PlanSection | None) -> list[str]:
    """How much better than the plan any other can be; none where no bound is known."""
    if section is None or section.loss is None:
        return []
    return [
        f"No plan within {section.budget_min:.0f} min is more than"
        f" {loss_bound_text(section.loss)}: a bound over all plans that take each"
        " measurement at most as often as `counts` allows."
    ]
