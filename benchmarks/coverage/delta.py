"""The linear delta with probe and calliper, read by the oracle of three spheres."""

from __future__ import annotations

import numpy as np

from benchmarks.coverage.bench import Bench
from oed.compensate import compensated_joints
from oed.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import calliper, height_probe
from pkm_models.machines import linear_delta
from tests.oracles import delta_trilateration as oracle

SIZE = len(linear_delta.machine.parameters)
NOISE = {"probe": 30e-6, "calliper": 60e-6}


def delta() -> Bench:
    """Heights of a bed in three passes, distances on an object at two heights."""
    m = Measurement(
        linear_delta.machine,
        [
            mount(height_probe.instrument, "probe", sigma=[NOISE["probe"]]),
            mount(
                calliper.instrument,
                "calliper",
                sigma=[NOISE["calliper"]],
                tolerances={"scale": 0.0},
            ),
        ],
    )
    bed, passes = _bed()
    places, objects = _object()
    heights = m.series("probe", bed, run=passes)
    distances = m.series("calliper", places, run=objects)
    offset = m.names.index("probe.offset")

    def read(theta: np.ndarray) -> np.ndarray:
        tips = _nozzle(heights.q, theta[:SIZE])
        touched = tips[heights.index[:, 0], 2] + theta[offset]
        tips = _nozzle(distances.q, theta[:SIZE])
        apart = tips[distances.index[:, 0]] - tips[distances.index[:, 1]]
        return np.concatenate([touched, np.linalg.norm(apart, axis=1)])

    command = _workspace()

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        poses = np.vstack([command, m.machine.home_command])
        joints = compensated_joints(m.kinematics, poses, believed)
        error = _nozzle(joints, true) - poses
        return error[:-1] - error[-1]

    return Bench(
        name="delta",
        about="linear delta, heights in three passes and distances on two objects",
        measurement=m,
        series=[heights, distances],
        command=command,
        read=read,
        errors=errors,
    )


def _nozzle(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Nozzle (n, 3) at travels (n, 3): parameters radius, arms, angles, endstops."""
    return oracle.nozzle(q, p[0], p[1:4], p[4:7], p[7:10])


def _bed() -> tuple[np.ndarray, list[str]]:
    """Nineteen points of a bed, probed in three passes."""
    angle = np.arange(6) * np.pi / 3.0
    inner = np.column_stack([np.cos(angle), np.sin(angle)])
    outer = np.column_stack([np.cos(angle + np.pi / 6), np.sin(angle + np.pi / 6)])
    plane = np.vstack([[[0.0, 0.0]], 0.06 * inner, 0.12 * inner, 0.11 * outer])
    points = np.column_stack([plane, np.zeros(len(plane))])
    return np.tile(points, (3, 1)), np.repeat(["a", "b", "c"], len(points)).tolist()


def _object() -> tuple[np.ndarray, list[str]]:
    """Distances from one edge to nine others, at heights of 5 and 100 mm."""
    angle = 2.0 * np.pi * np.arange(10) / 10.0
    ring = 0.09 * np.column_stack([np.cos(angle), np.sin(angle)])
    points = [np.column_stack([ring, np.full(10, z)]) for z in (0.005, 0.1)]
    return np.vstack(points), np.repeat(["low", "high"], 10).tolist()


def _workspace() -> np.ndarray:
    x = np.array([-0.09, -0.045, 0.0, 0.045, 0.09])
    grid = np.meshgrid(x, x, [0.03, 0.12, 0.22], indexing="ij")
    return np.column_stack([v.ravel() for v in grid])
