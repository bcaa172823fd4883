"""Uncertainty budget: what each source adds to the errors of the compensated machine."""

from oed.budget.linearisation import variance_over_machines
from oed.budget.lines import Budget, Line, budget_of, mean_variance
from oed.budget.model import BudgetModel, Part, budget_model

__all__ = [
    "Budget",
    "BudgetModel",
    "Line",
    "Part",
    "budget_model",
    "budget_of",
    "mean_variance",
    "variance_over_machines",
]
