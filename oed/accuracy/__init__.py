"""Errors over the workspace after compensation: prediction, budget, acceptance.

ErrorMaps      slopes of pose errors over parameters, at commands
Prediction     errors over a workspace, after compensation
budget_model   readings and their shared errors, for a budget
driven_errors  exact errors of pose components at commands
error_maps     the maps of a workspace
predict        the errors that a posterior predicts
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.accuracy.budget import budget_model
    from oed.accuracy.maps import ErrorMaps, driven_errors, error_maps
    from oed.accuracy.prediction import Prediction, predict
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
