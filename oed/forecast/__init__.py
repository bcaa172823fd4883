"""Forecast compensation: a field of errors, where to read it, and a controller's table.

JointErrors      errors of driven components as functions of errors of the joints
joint_size       size of joint errors that make errors of the components
Kernel           covariance of the errors of a joint over the workspace
expected_kernel  that before any reading
NodeDesign       candidates to read, and the error between them
design_nodes     chooses them until the wanted accuracy
ErrorField       errors of the driven components, given readings
fit_error_field  the field that readings make most probable
Forecast         a controller's table and what it leaves
forecast_table   the table of an estimated field
INTERVAL_LEVELS  probabilities of the ends of the interval of what it leaves
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.forecast.error_field import (
        INTERVAL_LEVELS,
        ErrorField,
        Forecast,
        Kernel,
        NodeDesign,
        design_nodes,
        expected_kernel,
        fit_error_field,
        forecast_table,
        joint_size,
    )
    from oed.forecast.joint_errors import JointErrors
else:
    __getattr__ = door(__name__)
