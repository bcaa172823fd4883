"""The hexapod with a ball bar, read by the oracle that knows no orientation."""

from __future__ import annotations

import itertools

import numpy as np

from benchmarks.coverage.bench import Bench, components_from_home
from oed.compensate import compensated_joints
from oed.measurement import Measurement, commands_at_fixed_reading
from oed.mechanism.kinematics import Kinematics
from oed.model.instrument import mount
from pkm_models.instruments import ball_bar
from pkm_models.machines import hexapod as model
from tests.oracles import hexapod_geometry as oracle

SIZE, BAR, CUP = 42, 0.3, np.array([0.0, 0.0, 0.2])
TILT = np.deg2rad(15.0)
NO_TOOL = np.zeros(3)


def hexapod() -> Bench:
    """Seventy-two readings on the bar's sphere, in three runs."""
    at = dict(zip(("at_x", "at_y", "at_z"), CUP, strict=True))
    m = Measurement(model.machine, [mount(ball_bar.free_cup, "bar", length=BAR, **at)])
    side, tilts = (-0.1, 0.0, 0.1), (-TILT, TILT)
    poses = itertools.product(side, side, [0.45], tilts, tilts, tilts)
    command, solved = commands_at_fixed_reading(m, "bar", np.array([*poses]), "z")
    assert solved.all()
    series = m.series("bar", command, run=[f"x {row[0]}" for row in command])

    def read(theta: np.ndarray) -> np.ndarray:
        points, _ = _poses(m.kinematics, series.q, series.start, theta[:SIZE])
        return np.linalg.norm(points - CUP - theta[SIZE:], axis=1)

    workspace = _workspace()

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        return _errors(m, workspace, believed, true)

    return Bench(
        name="hexapod",
        about="hexapod, ball bar, 72 readings in three runs",
        measurement=m,
        series=[series],
        command=workspace,
        read=read,
        errors=errors,
    )


def _workspace() -> np.ndarray:
    """Sixteen poses (16, 6)."""
    side, height, tilt = (-0.1, 0.1), (0.45, 0.55), np.deg2rad((-10.0, 10.0))
    poses = itertools.product(side, side, height, tilt, [0.1], [0.0])
    return np.array([*poses])


def _poses(
    kinematics: Kinematics, q: np.ndarray, near: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tool points (n, 3) and rotations (n, 3, 3) by the oracle, near poses (n, 6)."""
    base, local = (np.array([*joints.values()]) for joints in (model.B, model.A))
    base, local = base + p[:18].reshape(6, 3), local + p[18:36].reshape(6, 3)
    rotation, point, _ = kinematics.frames(near, NO_TOOL)
    solved = [
        oracle.forward(qi + p[36:], base, local, xi + local @ ri.T)
        for qi, xi, ri in zip(q, point, rotation, strict=True)
    ]
    return np.array([s[0] for s in solved]), np.array([s[1] for s in solved])


def _errors(
    m: Measurement, command: np.ndarray, believed: np.ndarray, true: np.ndarray
) -> np.ndarray:
    """Errors (n, 6) in place and rotation vector, zeroed at home."""
    poses = np.vstack([command, m.machine.home_command])
    start, _ = m.kinematics.inverse(poses)
    joints = compensated_joints(m.kinematics, poses, believed)
    points, rotations = _poses(m.kinematics, joints, start, true)
    return components_from_home(m, command, rotations, points)
