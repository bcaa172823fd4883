"""Forecast compensation: an error grid relative to a reference, subtracted in advance.

Chang, Li and Li (2011), section 3: with the errors dX_i at command X_i and dX_0 at the
reference, the drives get X_i' = X_i - (dX_i - dX_0), interpolated linearly between the
nodes of a grid. Here the errors are carried through the kinematics to the joints, so that
the commands need not be the coordinates in which errors are stated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from oed.base import Array
from oed.compensate import CommandGrid, GridAxis, choose_command_grid, joint_motion
from oed.forecast.error_field import ErrorField

#: interpolation in the table may cost this share of the rms that the field leaves
SHARE = 0.2
#: draws of the field, for the interval of its rms, and its ends
DRAWS, INTERVAL = 400, (0.025, 0.975)


@dataclasses.dataclass(frozen=True, eq=False)
class Forecast:
    """A controller's table and what it leaves.

    grid       commands of the table
    joints     (n, nq) to add to the joints at its commands, SI
    predicted  (k,) rms over the workspace, SI: of the field and of interpolation
    interval   (2, k) 95 % interval of it, SI
    """

    grid: CommandGrid
    joints: Array
    predicted: Array
    interval: Array


def forecast_table(
    field: ErrorField,
    known: Callable[[Array], Array],
    axes: tuple[GridAxis, ...],
    largest: int,
    rng: np.random.Generator,
) -> Forecast:
    """The table of an estimated field of errors.

    known    errors (n, k) that the parameters predict, at commands, SI
    axes     of the table
    largest  number of its commands

    Raises AssemblyError where a place of the box is out of reach.
    """
    kinematics = field.model.kinematics
    workspace = field.model.command
    covariance = field.covariance(workspace)
    shape = (len(workspace), -1)
    variance = np.maximum(np.diag(covariance), 0.0).reshape(shape).mean(axis=0)

    def errors(command: Array) -> Array:
        return known(command) + field.mean(command)

    def correction(command: Array) -> Array:
        inverse = np.linalg.pinv(joint_motion(kinematics, command))
        return np.asarray(-np.einsum("nqk,nk->nq", inverse, errors(command))[:, None])

    grid = choose_command_grid(
        axes,
        correction,
        lambda command: joint_motion(kinematics, command),
        SHARE * np.sqrt(variance),
        largest,
        rng,
    )
    interpolation = grid.errors.max(axis=0) ** 2
    drawn = _rms_draws(covariance, shape, rng)
    low, high = np.quantile(drawn**2 + interpolation, INTERVAL, axis=0)
    return Forecast(
        grid=grid,
        joints=correction(grid.commands)[:, 0],
        predicted=np.sqrt(variance + interpolation),
        interval=np.sqrt([low, high]),
    )


def _rms_draws(
    covariance: Array, shape: tuple[int, int], rng: np.random.Generator
) -> Array:
    """Rms (DRAWS, k) over the workspace of draws of what the field leaves."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = rng.standard_normal((DRAWS, len(values))) @ root.T
    return np.asarray(np.sqrt((drawn.reshape(DRAWS, *shape) ** 2).mean(axis=1)))
