"""Checks a prediction on virtual machines: read, identified, compensated, measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from oed.accuracy import Reference, Spread, driven_errors
from oed.base import Array
from oed.estimation import fit_machines
from oed.measurement import Measurement, Series, draw_parameters

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
        errors.append(
            driven_errors(
                measurement.kinematics, command, true, reference, believed=identified
            )
        )
        if progress is not None:
            progress((start + machines) / count)
    table = np.concatenate(errors)
    return {
        c.name: Spread.of_errors(table[:, :, k])
        for k, c in enumerate(measurement.machine.components)
    }


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
        truth.append(draw_parameters(measurement, rng))
        errors.append(noise.draw(rng, (len(noise.sigma),)))
    exact = measurement.readings(series, np.array(truth))
    return np.array(truth), exact + np.array(errors)
