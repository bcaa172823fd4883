"""Commands over the workspace of a study's machine, and the axes of its box."""

from __future__ import annotations

import numpy as np
from scipy import spatial
from scipy.stats import qmc

from oed.base import Array, grid_nodes
from oed.compensate import GridAxis, box_axes
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies.resolve.prediction import prediction_request
from pkm_studies.study import Study

#: places along a coordinate of the workspace where the study names none
PLACES = 5


def workspace_axes(study: Study, machine: Machine) -> tuple[GridAxis, ...]:
    """Axes of the box of the commands of [prediction], or of the workspace.

    Accuracy that is zeroed at home needs the corrections of home: the box reaches it.
    """
    prediction = prediction_request(study, machine)
    if prediction is None:
        return box_axes(machine, _lattice(machine))
    axes = box_axes(machine, prediction.command)
    if prediction.table.reference != "home":
        return axes
    pairs = zip(axes, machine.home_command, strict=True)
    return tuple(axis.reaching(float(location)) for axis, location in pairs)


def _lattice(machine: Machine) -> Array:
    """Commands (n, n_dof) over the workspace, whether in reach or not."""
    knots = tuple(np.linspace(c.lower, c.upper, PLACES) for c in machine.command)
    return grid_nodes(knots)


def workspace_commands(study: Study, kinematics: Kinematics) -> Array:
    """Commands (n, n_dof): those of [prediction], or a grid over the workspace."""
    machine = kinematics.machine
    prediction = prediction_request(study, machine)
    if prediction is not None:
        return prediction.command
    return _reachable(kinematics, _lattice(machine))


def regular_commands(study: Study, kinematics: Kinematics) -> Array:
    """Those of `workspace_commands` at which every pose component has an error."""
    return regular_at(kinematics, workspace_commands(study, kinematics))


def regular_at(kinematics: Kinematics, command: Array) -> Array:
    """Those commands (n, n_dof) at which every pose component has an error.

    Where a tilt is zero, its direction has none.
    """
    slopes = kinematics.error_components_jacobian(command)
    is_regular = np.isfinite(slopes).all(axis=(1, 2))
    return command[is_regular]


def commands_between(kinematics: Kinematics, command: Array, count: int) -> Array:
    """At most `count` further commands (m, n_dof), spread evenly between some (n, n_dof).

    They are within half a diagonal of the grid from one of these, so that they stay in
    the workspace whatever its shape.
    """
    low, size = command.min(axis=0), np.ptp(command, axis=0)
    varied = size > 0.0
    dimensions = int(varied.sum())
    if not dimensions or len(command) < 2:
        return command[:0]
    grid = (command - low)[:, varied] / size[varied]
    tree = spatial.KDTree(grid)
    spacing = float(tree.query(grid, k=2)[0][:, 1].max())
    # without its first point, which is a corner
    points = qmc.Halton(dimensions, scramble=False).random(count + 1)[1:]
    near = tree.query(points)[0] <= 0.5 * np.sqrt(dimensions) * spacing
    if not near.any():
        return command[:0]
    further = np.repeat(command[:1], int(near.sum()), axis=0)
    further[:, varied] = low[varied] + size[varied] * points[near]
    return regular_at(kinematics, _reachable(kinematics, further))


def _reachable(kinematics: Kinematics, command: Array) -> Array:
    while len(command):
        try:
            kinematics.inverse(command)
        except AssemblyError as error:
            command = np.delete(command, error.indices, axis=0)
        else:
            return command
    return kinematics.machine.home_command[None]
