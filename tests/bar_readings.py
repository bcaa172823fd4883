"""Ball bar readings of independent A3 heads, in two set-ups of two circles each."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray
from oracles import a3_geometry as a3

from oed import checks
from oed.measurement.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head

Array = NDArray[np.float64]

SIGMA, POINTS, LENGTH = 0.5e-6, 12, 0.3
#: set-up: tool, heights of the circles, teach height (m)
SETUPS = {
    "cup": (0.0, (1.146, 1.266), 1.286),
    "long_tool": (0.1, (1.246, 1.366), 1.386),
}


@dataclasses.dataclass(frozen=True)
class Readings:
    """What is written into a file: commands (n, 3) by set-up, readings (N,), SI."""

    command: dict[str, Array]
    y: Array

    def with_y(self, y: Array) -> Readings:
        return dataclasses.replace(self, y=y)


@functools.cache
def a3_measurement() -> Measurement:
    setups = [
        mount(
            ball_bar.instrument,
            name,
            tool=(0.0, 0.0, tool),
            teach=(teach, 0.0, 0.0),
            sigma=[SIGMA],
        )
        for name, (tool, _, teach) in SETUPS.items()
    ]
    return Measurement(a3_head.machine, setups)


def a3_commands(setup: str) -> Array:
    """Circles (n, 3) on which the bar of 300 mm leads the tool."""
    tool, heights, teach = SETUPS[setup]
    cup = np.array([0.0, 0.0, teach])
    psi = np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False)
    circles = []
    for z in heights:
        theta = a3.circle_theta(z, psi, cup, LENGTH, tool)
        circles.append(np.column_stack([np.full(POINTS, z), psi, theta]))
    return np.vstack(circles)


def a3_errors(rng: np.random.Generator) -> Array:
    """Errors (24,) of a machine: 1 mm and 0.01 rad, one standard deviation."""
    p = a3.errors(
        dq=1e-3 * rng.standard_normal(3),
        db=1e-3 * rng.standard_normal((3, 3)) * FREE_BASE,
        da0=1e-3 * rng.standard_normal((3, 3)),
        beta=0.01 * rng.standard_normal(3),
    )
    return np.asarray(p)


#: errors of the base joints that do not choose the frame
FREE_BASE = np.array([[0, 1, 0], [1, 0, 0], [1, 0, 0]])


def a3_lengths(p: Array, rng: np.random.Generator, longer: float = 0.0) -> Array:
    """Exact lengths of both set-ups; the tools may be longer than stated, m."""
    lengths = []
    for name, (tool, _, teach) in SETUPS.items():
        z, psi, theta = a3_commands(name).T
        q = a3.inverse_nominal(z, psi, theta, tool=tool)
        home = a3.inverse_nominal(teach, 0.0, 0.0, tool=tool)
        cup = a3.forward(p, home, tool + longer).tip + 2e-5 * rng.standard_normal(3)
        tip = a3.forward(p, q, tool + longer).tip
        lengths.append(np.linalg.norm(tip - cup, axis=-1))
    return np.concatenate(lengths)


def a3_readings(seed: int, noise: float = SIGMA, longer: float = 0.0) -> Readings:
    rng = np.random.default_rng([2026, seed])
    y = a3_lengths(a3_errors(rng), rng, longer)
    y = y + noise * rng.standard_normal(len(y))
    command = {name: a3_commands(name) for name in SETUPS}
    return Readings(command, y)


def session(readings: Readings) -> checks.SessionReadings:
    """The session of a file with these readings."""
    measurement = a3_measurement()
    series = []
    for setup, command in readings.command.items():
        run = [f"{setup} {k // POINTS + 1}" for k in range(len(command))]
        series.append(measurement.series(setup, command, run))
    return checks.session(measurement, series, readings.y)


def check(readings: Readings) -> checks.CheckedSession:
    """What a check says of these readings."""
    one = session(readings)
    measurement = one.measurement
    return checks.check_session(one, measurement, np.random.default_rng(0))
