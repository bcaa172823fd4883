"""Checks a prediction on virtual machines: read, identified, compensated, measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from oed import compensate, identification, prediction, simulation
from oed.arrays import Array
from oed.measurement import Measurement, Series
from oed.prediction import Reference, Spread


def realised_accuracy(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    reference: Reference,
    count: int,
    rng: np.random.Generator,
    stages: Sequence[Sequence[str]],
    progress: Callable[[float], None],
) -> dict[str, Spread] | None:
    """True pose error after compensation, by component, of `count` drawn machines.

    command   (n, n_dof) commands at which the error is computed
    stages    patterns of the parameters freed in turn
    progress  called with the share of machines that are done

    None where no machine is asked for.
    """
    if not count:
        return None
    kinematics = measurement.kinematics
    keep = len(measurement.machine.parameters)
    home = measurement.machine.home_command[None]
    model = compensate.error_model(kinematics, command)
    home_model = compensate.error_model(kinematics, home)
    errors = []
    for k in range(count):
        truth = simulation.draw_parameters(measurement, rng)
        y = simulation.draw_readings(measurement, series, truth, rng)
        estimate = identification.identify(measurement, series, y, stages=stages)
        identified, true = estimate.theta[:keep], truth[:keep]
        twist = _remaining_twist(measurement, command, identified, true)
        home_twist = _remaining_twist(measurement, home, identified, true)
        referenced = prediction.relative_to_reference(
            twist, home_twist, model, home_model, reference, measurement.machine.lever
        )
        errors.append(kinematics.error_components(command, referenced))
        progress((k + 1) / count)
    table = np.array(errors)
    return {
        c.name: prediction.error_spread(table[:, :, k])
        for k, c in enumerate(measurement.machine.components)
    }


def _remaining_twist(
    measurement: Measurement, command: Array, identified: Array, true: Array
) -> Array:
    """Pose error (n, 6) at commands, driven with the identified parameters."""
    kinematics = measurement.kinematics
    q = compensate.compensated_joints(kinematics, command, identified)
    return compensate.pose_error(kinematics, command, q, true)
