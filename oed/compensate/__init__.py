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
from oed.compensate.exact import (
    command_of_pose,
    compensated_joints,
    corrected_commands,
    joint_corrections,
    undriven_components,
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
    "CommandGrid",
    "ErrorModel",
    "FurtherAxes",
    "FurtherAxis",
    "GridAxis",
    "InterpolationTable",
    "box_axes",
    "choose_command_grid",
    "command_of_pose",
    "compensated_joints",
    "component_errors",
    "corrected_commands",
    "error_model",
    "further_axes",
    "joint_corrections",
    "joint_motion",
    "pose_error",
    "twist_between",
    "undriven_components",
]
