"""The A3 head with a ball bar, read by the oracle of swing angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.coverage.bench import Bench, components_from_home
from oed.compensate import compensated_joints
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from oed.model.instrument import mount
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head
from tests.oracles import a3_geometry as a3

#: length of the second tool, m; heights of the tool point, m
LONG_TOOL = 0.1
TWO, FOUR = (1.146, 1.266), (1.106, 1.159, 1.213, 1.266)
SIZE = len(a3_head.machine.parameters)


def thirty() -> Bench:
    """The paper's plan."""
    about = "A3 head, two circles of 15 readings, one set-up"
    return _bench("a3_30", about, TWO, ("cup",))


def sixty() -> Bench:
    """The paper's plan with two tools."""
    about = "A3 head, two circles of 15 readings with each of two tools"
    return _bench("a3_60", about, TWO, ("cup", "long_tool"))


def four_circles() -> Bench:
    """Twice as many circles."""
    about = "A3 head, four circles of 15 readings, one set-up"
    return _bench("a3_circles", about, FOUR, ("cup",))


def _bench(name: str, about: str, z: Sequence[float], setups: Sequence[str]) -> Bench:
    tools = {"cup": 0.0, "long_tool": LONG_TOOL}
    mounted = [
        mount(
            ball_bar.instrument,
            setup,
            tool=(0.0, 0.0, tools[setup]),
            teach=(a3.Z_TEACH + tools[setup], 0.0, 0.0),
        )
        for setup in setups
    ]
    m = Measurement(a3_head.machine, mounted)
    series = [_circles(m, setup, np.add(z, tools[setup])) for setup in setups]

    def read(theta: np.ndarray) -> np.ndarray:
        parts = []
        for k, s in enumerate(series):
            offset = theta[SIZE + 3 * k : SIZE + 3 * k + 3]
            tool = tools[s.setup]
            poses, teach = s.q[s.index[:, 0]], s.q[s.index[:, 1]]
            cup = a3.forward(theta[:SIZE], teach, tool).tip + offset
            parts.append(a3.ball_bar_reading(theta[:SIZE], poses, cup, tool))
        return np.concatenate(parts)

    command = _workspace()

    def errors(believed: np.ndarray, true: np.ndarray) -> np.ndarray:
        return _errors(m, command, believed, true)

    return Bench(
        name=name,
        about=about,
        measurement=m,
        series=series,
        stages=(("dq*",), ("*",)),
        command=command,
        read=read,
        errors=errors,
    )


def _circles(m: Measurement, setup: str, heights: np.ndarray) -> Series:
    """Fifteen readings on a circle at each height."""
    psi = 2.0 * np.pi * np.arange(15) / 15.0
    command = np.array([[z, angle, 0.0] for z in heights for angle in psi])
    command, solved = commands_at_fixed_reading(m, setup, command, "theta")
    assert solved.all()
    return m.series(setup, command, run=[f"z {row[0]:.3f}" for row in command])


def _workspace() -> np.ndarray:
    """Poses (72, 3) over stroke, direction and tilt."""
    z = np.array([1.066, 1.166, 1.266])
    psi = 2.0 * np.pi * np.arange(6) / 6.0
    theta = np.deg2rad([5.0, 15.0, 25.0, 35.0])
    grid = np.meshgrid(z, psi, theta, indexing="ij")
    return np.column_stack([v.ravel() for v in grid])


def _errors(
    m: Measurement, command: np.ndarray, believed: np.ndarray, true: np.ndarray
) -> np.ndarray:
    """Errors (n, 6) in x, y, z, psi, theta, phi, zeroed at home."""
    poses = np.vstack([command, m.machine.home_command])
    real = a3.forward(true, compensated_joints(m.kinematics, poses, believed))
    return components_from_home(m, command, real.R, real.tip)
