"""Errors over the workspace after compensation: maps, prediction, budget.

Budget                  sources of the errors of the compensated machine
BudgetModel             readings of parameters, linear, and the budget that they give
ErrorMaps               pose errors per parameter, at commands
Prediction              errors over a workspace, before and after compensation
Reference               against which pose errors are stated
Spread                  errors of one pose component over poses and machines
components_against      errors of pose components against a reference, from twists
driven_errors           exact errors of pose components at commands
least_error             the compensation of least expected error
predict                 the errors that a posterior predicts
relative_to_reference   twist errors of one machine, relative to a reference
spread_after            the errors after compensation alone
variance_over_machines  variances over machines as they may be built
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.accuracy.budget import Budget, BudgetModel, variance_over_machines
    from oed.accuracy.maps import (
        ErrorMaps,
        Reference,
        components_against,
        driven_errors,
        relative_to_reference,
    )
    from oed.accuracy.prediction import (
        Prediction,
        Spread,
        least_error,
        predict,
        spread_after,
    )
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
