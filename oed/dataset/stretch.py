"""Corrects recorded cable robots for the stretch that their recorded tensions cause.

A drum pays out the free length L0 of its cable. Under the tension T the cable is

    L = L0 (1 + T / (E A))

long (Pott 2018, Cable-Driven Parallel Robots, section 4.2), so that its joint is in
effect further out by the joint change that is worth L - L0.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.measurement.measurement import Measurement, Series

#: most passes, and the change of a joint after which no further one follows, m or rad;
#: each pass lowers the stretch's error by about the strain
MOST_PASSES, SETTLED = 20, 1e-12


def with_stretch(measurement: Measurement, series: Series, tension: Array) -> Series:
    """The series with the joints (m, nq) at which cables that do not stretch are as long.

    tension  (n, nq) at the first n poses, N; NaN where it is not recorded. A teach
             pose, which follows them, has that of the first

    Cables without known tension or stiffness E A stay as they are. Lengths are those of
    the nominal machine: their errors count as far as the strain. Raises AssemblyError.
    """
    machine, kinematics = measurement.machine, measurement.kinematics
    if machine.cable_stiffness is None or not len(tension):
        return series
    strain = np.nan_to_num(tension / np.array(machine.cable_stiffness))
    if not strain.any():
        return series
    taught = np.repeat(strain[:1], len(series.q) - len(strain), axis=0)
    strain = np.vstack([strain, taught])
    x, q = series.start, series.q
    for _ in range(MOST_PASSES):
        base, platform, per_length = kinematics.struts(x, q, machine.nominal)
        length = np.linalg.norm(platform - base, axis=-1)
        before, q = q, series.q + per_length * length * strain / (1.0 + strain)
        x = kinematics.forward(q, machine.nominal, x)
        if np.abs(q - before).max() < SETTLED:
            break
    return dataclasses.replace(series, q=q, start=x)
