"""Minutes, budgets, accuracies and measurements of a plan in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from oed.result import AlternativePlan, PlanSection
from pkm_reports import missing, text


def minutes(value: float | None) -> str:
    """33 min."""
    return text.quantity(value, "min")


def budget_phrase(plan: PlanSection) -> str:
    """` within 120 min`, or nothing where there is no budget."""
    return "" if plan.budget_min is None else f" within {_budget(plan.budget_min)}"


def budget_share(plan: PlanSection) -> str:
    """` of a budget of 120 min`, or nothing where there is none."""
    if plan.budget_min is None:
        return ""
    return f" of a budget of {_budget(plan.budget_min)}"


def _budget(minutes: float) -> str:
    return text.append_unit(text.trimmed(minutes), "min")


def accuracies(table: Mapping[str, float], only: Iterable[str] | None = None) -> str:
    """z 30.0 µm and theta 2.00 arcsec; of all components, or of some (`only`)."""
    parts = []
    for key in table if only is None else only:
        rms = missing.entry(table, key)
        if math.isfinite(rms):
            stem, unit = text.split_unit(key)
            parts.append(f"{stem}{text.NO_BREAK}{text.quantity(rms, unit)}")
    return text.listing(parts)


def measurements(plan: AlternativePlan) -> str:
    """The measurements of a plan in order: rough tracker (12) → bar 300 (24)."""
    steps = []
    for k, name in enumerate(plan.names):
        has_readings = k < len(plan.readings)
        steps.append(f"{name} ({plan.readings[k]})" if has_readings else name)
    return " → ".join(steps) or "no reading"


def cells(table: Mapping[str, float], keys: Iterable[str]) -> list[str]:
    """Numbers of a table row."""
    return [text.number(missing.entry(table, key)) for key in keys]
