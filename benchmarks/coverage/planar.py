"""The planar manipulator with RM 4 and RM 5, read by the oracle of circles."""

from __future__ import annotations

import numpy as np

from benchmarks.coverage.bench import Bench
from oed.compensate import compensated_joints
from oed.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import relative
from pkm_models.machines import planar_2dof
from tests.oracles import planar_geometry as oracle

SIZE = 7
CHANNELS = {4: [0], 5: [0, 1]}


def planar() -> Bench:
    """The two measurements with which the paper calibrates."""
    instruments = {4: relative.rm4, 5: relative.rm5}
    m = Measurement(
        planar_2dof.machine, [mount(instruments[k], f"rm{k}") for k in CHANNELS]
    )
    lines = {k: oracle.lines(k) for k in CHANNELS}
    series = [
        m.series(f"rm{k}", pose, run=[str(label) for label in line])
        for k, (pose, line) in lines.items()
    ]

    def read(theta: np.ndarray) -> np.ndarray:
        parts = []
        for k, (pose, line) in lines.items():
            places = oracle.forward(oracle.inverse(pose), theta[:SIZE])
            parts.append(oracle.relative(places, line)[:, CHANNELS[k]].ravel())
        return np.concatenate(parts)

    y, z = np.meshgrid(np.linspace(-1.5, 1.5, 11), np.linspace(0.0, 1.5, 4))
    command = np.column_stack([y.ravel(), z.ravel()])

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        poses = np.vstack([command, m.machine.home_command])
        joints = compensated_joints(m.kinematics, poses, believed)
        error = oracle.forward(joints, true) - poses
        return error[:-1] - error[-1]

    return Bench(
        name="planar",
        about="planar manipulator, RM 4 and RM 5 on six lines",
        measurement=m,
        series=series,
        stages=(("beta*",), ("*",)),
        command=command,
        read=read,
        errors=errors,
    )
