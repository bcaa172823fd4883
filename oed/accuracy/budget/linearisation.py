"""Variance over machines as they may be built, and not about the nominal one alone.

The slopes of readings and poses change with the machine. The mean over drawn machines
less the variance about the nominal machine is what linearisation leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.accuracy.budget.model import budget_model
from oed.accuracy.maps import Reference, maps_by_reference
from oed.base.arrays import Array
from oed.measurement import simulation
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.mechanism.pose_errors import NO_TOOL

#: machines drawn
MACHINES = 48


def variance_over_machines(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    references: Sequence[Reference],
    rng: np.random.Generator,
    tool: Array = NO_TOOL,
) -> dict[Reference, Array]:
    """Variances (n, k), SI, at commands (n, n_dof) of what calibration leaves.

    They are means over machines drawn from the tolerances, by reference; none where
    hardly one of them can be assembled.
    """
    count = len(measurement.machine.parameters)
    sums: dict[Reference, Array] = {}
    assembled = 0
    for truth in simulation.draw_parameters(measurement, rng, MACHINES):
        try:
            covariance = budget_model(measurement, series, truth).covariance()
            by_reference = maps_by_reference(
                measurement.kinematics,
                command,
                references,
                tool,
                parameters=truth[:count],
            )
        except AssemblyError:
            continue
        assembled += 1
        for reference, maps in by_reference.items():
            carried = maps.raw @ covariance
            variance = np.einsum("nkp,nkp->nk", carried, maps.raw)
            sums[reference] = sums.get(reference, 0.0) + variance
    if assembled < MACHINES // 2:
        return {}
    return {reference: total / assembled for reference, total in sums.items()}
