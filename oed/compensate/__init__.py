"""Compensation: what a controller must be sent, and what stays uncorrected.

Each compensator stands in a file: parameters in the controller's model, the linear one
of Tian et al. (2016), the exact one, forecast grids, tables over states, and sequences.
"""

from oed.compensate.command_grid import (
    CommandGrid,
    GridAxis,
    box_axes,
    choose_command_grid,
    joint_motion,
)
from oed.compensate.error_field import Box, ErrorField, Kernel, fit_error_field
from oed.compensate.exact import (
    ExactCompensator,
    compensated_joints,
    corrected_commands,
    joint_corrections,
)
from oed.compensate.forecast import (
    ForecastCompensator,
    forecast_from_field,
    forecast_from_nodes,
    strut_motion,
)
from oed.compensate.further_axes import FurtherAxes, FurtherAxis, further_axes
from oed.compensate.grid_design import GridDesign, design_grid, expected_kernel
from oed.compensate.linear import LinearCompensator
from oed.compensate.parameters import ParameterCompensator
from oed.compensate.sequence import CompensatorSequence
from oed.compensate.setpoint import (
    Compensator,
    Conditions,
    Setpoint,
    uncompensated,
)
from oed.compensate.states import StateCompensator
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
    "Compensator",
    "CompensatorSequence",
    "Conditions",
    "ErrorField",
    "ErrorModel",
    "ExactCompensator",
    "ForecastCompensator",
    "FurtherAxes",
    "FurtherAxis",
    "GridAxis",
    "GridDesign",
    "InterpolationTable",
    "Kernel",
    "LinearCompensator",
    "ParameterCompensator",
    "Setpoint",
    "StateCompensator",
    "box_axes",
    "choose_command_grid",
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
    "uncompensated",
]
