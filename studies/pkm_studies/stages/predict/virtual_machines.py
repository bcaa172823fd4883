"""Checks a prediction on virtual machines: read, identified, compensated, measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from oed import compensate
from oed.accuracy import prediction
from oed.accuracy.maps import components_against
from oed.accuracy.prediction import Reference, Spread
from oed.base.arrays import Array
from oed.estimation.machine_fits import fit_machines
from oed.measurement import simulation
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL

#: machines that go through the check together
TOGETHER = 50


def realised_accuracy(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    reference: Reference,
    count: int,
    rng: np.random.Generator,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
    progress: Callable[[float], None] | None = None,
) -> dict[str, Spread] | None:
    """True pose error after compensation, by component, of `count` drawn machines.

    command   (n, n_dof) commands at which the error is computed
    stages    patterns of the parameters freed in turn
    progress  called with the share of machines that are done

    None where no machine is asked for.
    """
    if not count:
        return None
    keep = len(measurement.machine.parameters)
    errors = []
    for start in range(0, count, TOGETHER):
        machines = min(TOGETHER, count - start)
        truth, y = _draw_machines(measurement, series, machines, rng)
        theta = fit_machines(measurement, series, y, stages=stages)
        identified, true = theta[:, :keep], truth[:, :keep]
        errors.append(errors_after(measurement, command, reference, identified, true))
        if progress is not None:
            progress((start + machines) / count)
    table = np.concatenate(errors)
    return {
        c.name: prediction.error_spread(table[:, :, k])
        for k, c in enumerate(measurement.machine.components)
    }


def errors_after(
    measurement: Measurement,
    command: Array,
    reference: Reference,
    identified: Array,
    true: Array,
) -> Array:
    """Exact pose errors (m, n, k), SI, of m machines driven with identified parameters.

    command           (n, n_dof), SI
    identified, true  (m, np) parameters, SI

    Raises AssemblyError.
    """
    kinematics = measurement.kinematics
    poses = np.vstack([command, measurement.machine.home_command])
    twists = _remaining_twists(kinematics, poses, identified, true)
    return components_against(kinematics, command, twists, reference)


def _draw_machines(
    measurement: Measurement,
    series: Sequence[Series],
    machines: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """True parameters (m, n) and noisy readings (m, N) of machines, SI.

    Each machine draws its parameters, then its noise: how many machines are drawn
    together changes no number.
    """
    noise = measurement.noise(series)
    truth, errors = [], []
    for _ in range(machines):
        truth.append(simulation.draw_parameters(measurement, rng))
        errors.append(noise.draw(rng, (len(noise.sigma),)))
    exact = measurement.readings(series, np.array(truth))
    return np.array(truth), exact + np.array(errors)


def _remaining_twists(
    kinematics: Kinematics, command: Array, identified: Array, true: Array
) -> Array:
    """Pose errors (m, n, 6) at commands (n, n_dof), driven with identified parameters.

    Parameters (m, np) identified and true, SI. Raises AssemblyError.
    """
    m, n = len(true), len(command)
    x, _ = kinematics.inverse(command)
    wanted_rotation, wanted_point, _ = kinematics.frames(x, NO_TOOL)
    of_all = np.tile(command, (m, 1))
    q = compensate.compensated_joints(kinematics, of_all, np.repeat(identified, n, 0))
    start = np.tile(x, (m, 1))
    reached = kinematics.forward_per_pose(q, np.repeat(true, n, 0), start)
    rotation, point, _ = kinematics.frames(reached, NO_TOOL)
    shape = (m, n, 3)
    return compensate.twist_between(
        wanted_rotation, wanted_point, rotation.reshape(*shape, 3), point.reshape(shape)
    )
