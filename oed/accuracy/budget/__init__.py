"""Uncertainty budget: what each source adds to the errors of the compensated machine."""

from oed.accuracy.budget.lines import (
    Budget,
    Line,
    budget_of,
    mean_products,
    mean_variance,
    variance_over_machines,
)
from oed.accuracy.budget.model import BudgetModel, Part, budget_model

__all__ = [
    "Budget",
    "BudgetModel",
    "Line",
    "Part",
    "budget_model",
    "budget_of",
    "mean_products",
    "mean_variance",
    "variance_over_machines",
]
