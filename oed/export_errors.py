"""Pose errors that a compensation file adds to those of exact compensation.

They come from printed digits, from what the controller's model cannot hold, and from
interpolation between the commands of a table. All are against a stated reference, like
the predicted accuracy that they join.
"""

from __future__ import annotations

import numpy as np

from oed.arrays import Array
from oed.compensate import (
    InterpolationTable,
    compensated_joints,
    corrected_commands,
    error_model,
    pose_error,
)
from oed.compensate.table import grid_nodes
from oed.error_maps import Reference, relative_to_reference
from oed.kinematics import Kinematics

#: places in a table's box over which its interpolation error is averaged
PLACES = 400


def joint_errors(
    kinematics: Kinematics,
    command: Array,
    joints: Array,
    parameters: Array,
    reference: Reference,
) -> Array:
    """Errors (n, k) of the pose components at commands (n, n_dof), SI.

    joints      (n + 1, nq) to which the controller drives at the commands, then at home
    parameters  (np,) of the machine

    Raises AssemblyError.
    """
    machine = kinematics.machine
    home = machine.home_command[None]
    poses = np.vstack([command, home])
    exact = compensated_joints(kinematics, poses, parameters)
    twist = pose_error(kinematics, poses, joints, parameters)
    twist -= pose_error(kinematics, poses, exact, parameters)
    relative = relative_to_reference(
        twist[:-1],
        twist[-1:],
        error_model(kinematics, command),
        error_model(kinematics, home),
        reference,
        machine.alignment_lever,
    )
    return kinematics.error_components(command, relative)


def interpolation_errors(
    kinematics: Kinematics,
    knots: tuple[Array, ...],
    parameters: Array,
    reference: Reference,
    rng: np.random.Generator,
) -> Array:
    """Errors (n, k), SI, at random places of a table of corrected commands.

    The controller has the nominal model. It adds corrections, linear between the knots
    of each command coordinate; at home it has those of home.

    Raises AssemblyError.
    """
    nodes = grid_nodes(knots)
    correction = corrected_commands(kinematics, nodes, parameters) - nodes
    shape = tuple(len(places) for places in knots)
    names = tuple(c.name for c in kinematics.machine.command)
    table = InterpolationTable(names, knots, correction.reshape(*shape, -1))
    low, high = np.array([(places[0], places[-1]) for places in knots]).T
    places = rng.uniform(low, high, (PLACES, len(low)))
    home = kinematics.machine.home_command[None]
    sent = places + table.at(places)
    joints = np.vstack(
        [
            compensated_joints(kinematics, sent, kinematics.machine.nominal),
            compensated_joints(kinematics, home, parameters),
        ]
    )
    return joint_errors(kinematics, places, joints, parameters, reference)


def table_knots(command: Array) -> tuple[Array, ...] | None:
    """Knots of each coordinate of commands (n, n_dof); None where they are no grid."""
    knots = tuple(np.unique(column) for column in command.T)
    if np.prod([len(places) for places in knots]) != len(command):
        return None
    return knots
