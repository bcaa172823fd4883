"""Machines with their readings, as the toolkit plans them and as an oracle reads them.

The A3 head is read by the oracle of swing angles, the planar manipulator by that of
circles, the linear delta by that of three spheres, and the hexapod by one that knows no
orientation.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.coverage.noise import Layout
from oed.compensate import compensated_joints
from oed.estimation import IdentifiableCoordinates
from oed.instrument import mount
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from oed.mechanism import Kinematics
from pkm_models.instruments import ball_bar, calliper, height_probe, relative
from pkm_models.machines import a3_head, linear_delta, planar_2dof
from pkm_models.machines import hexapod as model
from tests.oracles import (
    a3_geometry,
    delta_trilateration,
    hexapod_geometry,
    planar_geometry,
)

#: pose errors (n, k) of the machine with true parameters, driven with believed ones; SI
Errors = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class Bench:
    """One configuration."""

    name: str  #: of the machines and errors that are drawn
    measurement: Measurement  #: the toolkit's
    series: Sequence[Series]  #: its planned readings, N in all
    command: np.ndarray  #: (n, n_dof) workspace poses, SI
    #: exact readings (N,) of the oracle's machine theta (n,), SI
    read: Callable[[np.ndarray], np.ndarray]
    errors: Errors  #: of the oracle's machine, zeroed at home
    stages: Sequence[Sequence[str]] = (("*",),)  #: of the identification

    @functools.cached_property
    def coordinates(self) -> IdentifiableCoordinates:
        """Identifiable combinations: those of the readings at nominal parameters."""
        m = self.measurement
        noise = m.noise(self.series)
        return IdentifiableCoordinates.of(m, self.series, m.nominal, noise)

    @functools.cached_property
    def layout(self) -> Layout:
        """Chains and stated noise of the readings."""
        chain, sigma, shared = [], [], []
        for s in self.series:
            setup = self.measurement.setups[s.setup]
            channels = setup.instrument.channels
            labels = {label: k for k, label in enumerate(dict.fromkeys(s.run))}
            run = np.repeat([labels[label] for label in s.run], len(channels))
            channel = np.tile(np.arange(len(channels)), len(s))
            begin = 0 if not chain else chain[-1].max() + 1
            chain.append(begin + run * len(channels) + channel)
            sigma.append(np.tile(setup.sigma, len(s)))
            common = np.array([c.shared for c in channels]) * setup.sigma
            shared.append(np.tile(common, len(s)))
        return Layout(*(np.concatenate(v) for v in (chain, sigma, shared)))


def components_from_home(
    m: Measurement, command: np.ndarray, rotation: np.ndarray, point: np.ndarray
) -> np.ndarray:
    """Pose error components (n, k) of a machine that was zeroed at home.

    rotation  (n + 1, 3, 3) of the oracle's machine, at the commands and at home
    point     (n + 1, 3)
    """
    poses = np.vstack([command, m.machine.home_command])
    x, _ = m.kinematics.inverse(poses)
    wanted, tip, _ = m.kinematics.frames(x, np.zeros(3))
    place = point - tip
    zeroed = rotation[:-1] @ rotation[-1].T @ wanted[-1]
    turn = Rotation.from_matrix(zeroed @ np.swapaxes(wanted[:-1], 1, 2)).as_rotvec()
    twist = np.hstack([place[:-1] - place[-1], turn])
    return m.kinematics.error_components(command, twist)


def errors_of_points(
    m: Measurement,
    command: np.ndarray,
    points: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Errors:
    """Errors (n, k) of a machine that only moves, zeroed at home.

    points  of joints (n, nq) and parameters, by the oracle (n, k)
    """

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        poses = np.vstack([command, m.machine.home_command])
        joints = compensated_joints(m.kinematics, poses, believed)
        error = points(joints, true) - poses
        return error[:-1] - error[-1]

    return errors


# -- A3 head with a ball bar -----------------------------------------------------------
LONG_TOOL = 0.1  #: length of the second tool, m; heights of the tool point, m
TWO, FOUR = (1.146, 1.266), (1.106, 1.159, 1.213, 1.266)
A3_SIZE = len(a3_head.machine.parameters)


def a3(name: str, z: Sequence[float], setups: Sequence[str]) -> Bench:
    """Circles of 15 readings at heights, as in the paper, with each tool of the set-ups."""
    tools = {"cup": 0.0, "long_tool": LONG_TOOL}
    mounted = [
        mount(
            ball_bar.instrument,
            setup,
            tool=(0.0, 0.0, tools[setup]),
            teach=(a3_geometry.Z_TEACH + tools[setup], 0.0, 0.0),
        )
        for setup in setups
    ]
    m = Measurement(a3_head.machine, mounted)
    series = [_circles(m, setup, np.add(z, tools[setup])) for setup in setups]

    def read(theta: np.ndarray) -> np.ndarray:
        parts = []
        for k, s in enumerate(series):
            offset = theta[A3_SIZE + 3 * k : A3_SIZE + 3 * k + 3]
            tool = tools[s.setup]
            poses, teach = s.q[s.index[:, 0]], s.q[s.index[:, 1]]
            cup = a3_geometry.forward(theta[:A3_SIZE], teach, tool).tip + offset
            parts.append(
                a3_geometry.ball_bar_reading(theta[:A3_SIZE], poses, cup, tool)
            )
        return np.concatenate(parts)

    command = _a3_workspace()

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        poses = np.vstack([command, m.machine.home_command])
        joints = compensated_joints(m.kinematics, poses, believed)
        real = a3_geometry.forward(true, joints)
        return components_from_home(m, command, real.R, real.tip)

    stages = (("dq*",), ("*",))
    return Bench(name, m, series, command, read, errors, stages)


def _circles(m: Measurement, setup: str, heights: np.ndarray) -> Series:
    """Fifteen readings on a circle at each height."""
    psi = 2.0 * np.pi * np.arange(15) / 15.0
    command = np.array([[z, angle, 0.0] for z in heights for angle in psi])
    command, solved = commands_at_fixed_reading(m, setup, command, "theta")
    assert solved.all()
    return m.series(setup, command, run=[f"z {row[0]:.3f}" for row in command])


def _a3_workspace() -> np.ndarray:
    """Poses (72, 3) over stroke, direction and tilt."""
    z = np.array([1.066, 1.166, 1.266])
    psi = 2.0 * np.pi * np.arange(6) / 6.0
    theta = np.deg2rad([5.0, 15.0, 25.0, 35.0])
    grid = np.meshgrid(z, psi, theta, indexing="ij")
    return np.column_stack([v.ravel() for v in grid])


# -- planar manipulator with RM 4 and RM 5 ---------------------------------------------
PLANAR_SIZE = 7
PLANAR_CHANNELS = {4: [0], 5: [0, 1]}


def planar() -> Bench:
    """The two measurements with which the paper calibrates."""
    instruments = {4: relative.rm4, 5: relative.rm5}
    m = Measurement(
        planar_2dof.machine, [mount(instruments[k], f"rm{k}") for k in PLANAR_CHANNELS]
    )
    lines = {k: planar_geometry.lines(k) for k in PLANAR_CHANNELS}
    series = [
        m.series(f"rm{k}", pose, run=[str(label) for label in line])
        for k, (pose, line) in lines.items()
    ]

    def read(theta: np.ndarray) -> np.ndarray:
        parts = []
        for k, (pose, line) in lines.items():
            places = planar_geometry.forward(
                planar_geometry.inverse(pose), theta[:PLANAR_SIZE]
            )
            parts.append(
                planar_geometry.relative(places, line)[:, PLANAR_CHANNELS[k]].ravel()
            )
        return np.concatenate(parts)

    y, z = np.meshgrid(np.linspace(-1.5, 1.5, 11), np.linspace(0.0, 1.5, 4))
    command = np.column_stack([y.ravel(), z.ravel()])
    errors = errors_of_points(m, command, planar_geometry.forward)
    stages = (("beta*",), ("*",))
    return Bench("planar", m, series, command, read, errors, stages)


# -- linear delta with probe and calliper ----------------------------------------------
DELTA_SIZE = len(linear_delta.machine.parameters)
DELTA_NOISE = {"probe": 30e-6, "calliper": 60e-6}


def delta() -> Bench:
    """Heights of a bed in three passes, distances on an object at two heights."""
    m = Measurement(
        linear_delta.machine,
        [
            mount(height_probe.instrument, "probe", sigma=[DELTA_NOISE["probe"]]),
            mount(
                calliper.instrument,
                "calliper",
                sigma=[DELTA_NOISE["calliper"]],
                tolerances={"scale": 0.0},
            ),
        ],
    )
    bed, passes = _delta_bed()
    places, objects = _delta_object()
    heights = m.series("probe", bed, run=passes)
    distances = m.series("calliper", places, run=objects)
    offset = m.names.index("probe.offset")

    def read(theta: np.ndarray) -> np.ndarray:
        tips = _nozzle(heights.q, theta[:DELTA_SIZE])
        touched = tips[heights.index[:, 0], 2] + theta[offset]
        tips = _nozzle(distances.q, theta[:DELTA_SIZE])
        apart = tips[distances.index[:, 0]] - tips[distances.index[:, 1]]
        return np.concatenate([touched, np.linalg.norm(apart, axis=1)])

    command = _delta_workspace()
    errors = errors_of_points(m, command, _nozzle)
    return Bench("delta", m, [heights, distances], command, read, errors)


def _nozzle(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Nozzle (n, 3) at travels (n, 3): parameters radius, arms, angles, endstops."""
    return delta_trilateration.nozzle(q, p[0], p[1:4], p[4:7], p[7:10])


def _delta_bed() -> tuple[np.ndarray, list[str]]:
    """Nineteen points of a bed, probed in three passes."""
    angle = np.arange(6) * np.pi / 3.0
    inner = np.column_stack([np.cos(angle), np.sin(angle)])
    outer = np.column_stack([np.cos(angle + np.pi / 6), np.sin(angle + np.pi / 6)])
    plane = np.vstack([[[0.0, 0.0]], 0.06 * inner, 0.12 * inner, 0.11 * outer])
    points = np.column_stack([plane, np.zeros(len(plane))])
    return np.tile(points, (3, 1)), np.repeat(["a", "b", "c"], len(points)).tolist()


def _delta_object() -> tuple[np.ndarray, list[str]]:
    """Distances from one edge to nine others, at heights of 5 and 100 mm."""
    angle = 2.0 * np.pi * np.arange(10) / 10.0
    ring = 0.09 * np.column_stack([np.cos(angle), np.sin(angle)])
    points = [np.column_stack([ring, np.full(10, z)]) for z in (0.005, 0.1)]
    return np.vstack(points), np.repeat(["low", "high"], 10).tolist()


def _delta_workspace() -> np.ndarray:
    x = np.array([-0.09, -0.045, 0.0, 0.045, 0.09])
    grid = np.meshgrid(x, x, [0.03, 0.12, 0.22], indexing="ij")
    return np.column_stack([v.ravel() for v in grid])


# -- hexapod with a ball bar -----------------------------------------------------------


HEXAPOD_SIZE, BAR, CUP = 42, 0.3, np.array([0.0, 0.0, 0.2])
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
        points, _ = _hexapod_poses(
            m.kinematics, series.q, series.start, theta[:HEXAPOD_SIZE]
        )
        return np.linalg.norm(points - CUP - theta[HEXAPOD_SIZE:], axis=1)

    workspace = _hexapod_workspace()

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        poses = np.vstack([workspace, m.machine.home_command])
        start, _ = m.kinematics.inverse(poses)
        joints = compensated_joints(m.kinematics, poses, believed)
        points, rotations = _hexapod_poses(m.kinematics, joints, start, true)
        return components_from_home(m, workspace, rotations, points)

    return Bench("hexapod", m, [series], workspace, read, errors)


def _hexapod_workspace() -> np.ndarray:
    """Sixteen poses (16, 6)."""
    side, height, tilt = (-0.1, 0.1), (0.45, 0.55), np.deg2rad((-10.0, 10.0))
    poses = itertools.product(side, side, height, tilt, [0.1], [0.0])
    return np.array([*poses])


def _hexapod_poses(
    kinematics: Kinematics, q: np.ndarray, near: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tool points (n, 3) and rotations (n, 3, 3) by the oracle, near poses (n, 6)."""
    base, local = (np.array([*joints.values()]) for joints in (model.B, model.A))
    base, local = base + p[:18].reshape(6, 3), local + p[18:36].reshape(6, 3)
    rotation, point, _ = kinematics.frames(near, NO_TOOL)
    solved = [
        hexapod_geometry.forward(qi + p[36:], base, local, xi + local @ ri.T)
        for qi, xi, ri in zip(q, point, rotation, strict=True)
    ]
    return np.array([s[0] for s in solved]), np.array([s[1] for s in solved])


# -- by name ---------------------------------------------------------------------------


A3_PLANS = {
    "a3_30": (TWO, ("cup",)),
    "a3_60": (TWO, ("cup", "long_tool")),
    "a3_circles": (FOUR, ("cup",)),
}
OTHERS = {"planar": planar, "delta": delta, "hexapod": hexapod}


@functools.cache
def configuration(name: str) -> Bench:
    """A configuration, compiled once."""
    return OTHERS[name]() if name in OTHERS else a3(name, *A3_PLANS[name])
