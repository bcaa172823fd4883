"""Forecast compensation: a field of errors, where to read it, and a controller's table.

JointErrors      errors of driven components as functions of errors of the joints
NodeDesign       candidates to read, and the error between them
plan_nodes       chooses them until the wanted accuracy
fit_error_field  the field that readings make most probable
Forecast         a controller's table and what it leaves
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.forecast.error_field import (
        Forecast,
        NodeDesign,
        fit_error_field,
        plan_nodes,
    )
    from oed.forecast.joint_errors import JointErrors
else:
    __getattr__ = door(__name__)
