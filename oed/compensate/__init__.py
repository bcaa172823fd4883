"""Compensation: what a controller must be sent, and what stays uncorrected.

Joints and commands follow through the closure, errors that come back at a place by a
forecast grid, and those of states by tables (`oed.compensate.effects`).
"""

from oed.compensate.command_grid import (
    CommandGrid,
    GridAxis,
    box_axes,
    choose_command_grid,
    joint_motion,
)
from oed.compensate.error_field import (
    Box,
    ErrorField,
    GridDesign,
    Kernel,
    design_grid,
    expected_kernel,
    fit_error_field,
)
from oed.compensate.exact import (
    command_of_pose,
    compensated_joints,
    corrected_commands,
    joint_corrections,
    undriven_components,
)
from oed.compensate.forecast import (
    ForecastCompensator,
    forecast_from_field,
    forecast_from_nodes,
    strut_motion,
)
from oed.compensate.further_axes import FurtherAxes, FurtherAxis, further_axes
from oed.compensate.table import InterpolationTable
from oed.mechanism.error_model import ErrorModel, error_model
from oed.mechanism.pose_errors import (
    NO_TOOL,
    component_errors,
    pose_error,
    twist_between,
)

__all__ = [
    "NO_TOOL",
    "Box",
    "CommandGrid",
    "ErrorField",
    "ErrorModel",
    "ForecastCompensator",
    "FurtherAxes",
    "FurtherAxis",
    "GridAxis",
    "GridDesign",
    "InterpolationTable",
    "Kernel",
    "box_axes",
    "choose_command_grid",
    "command_of_pose",
    "compensated_joints",
    "component_errors",
    "corrected_commands",
    "design_grid",
    "error_model",
    "expected_kernel",
    "fit_error_field",
    "forecast_from_field",
    "forecast_from_nodes",
    "further_axes",
    "joint_corrections",
    "joint_motion",
    "pose_error",
    "strut_motion",
    "twist_between",
    "undriven_components",
]
