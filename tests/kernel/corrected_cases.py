"""Machines of the toolkit with their oracles, plans and workspaces, for the corrected
model.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from oracles import a3_geometry as a3
from oracles import delta_trilateration as delta
from oracles import hexapod_geometry as hexa
from oracles import planar_geometry as planar

from kernel import a3_plans
from oed.measurement.measurement import Measurement, Series
from oed.model.instrument import mount
from pkm_models.instruments import camera
from pkm_models.machines import hexapod, linear_delta, planar_2dof

#: readings of a closed run, commands on its way from one to the next, and the noise of
#: one reading by a camera, m
POINTS, FINE, SIGMA = 24, 50, 2e-6


@dataclasses.dataclass(frozen=True)
class MachineCase:
    """A machine of the toolkit and its oracle.

    measurement  with one set-up
    paths        (r, n FINE, n_dof) commands along closed runs; every FINE-th is read
    command      (m, n_dof) workspace at which errors are compared
    read         (theta, series, joints as driven at its poses) -> readings (N,), no noise
    errors       (p, joints as driven (m, nq), command) -> (m, k), of the components
    components   names (k,) that are compared
    """

    name: str
    measurement: Measurement
    paths: np.ndarray
    command: np.ndarray
    read: Callable[[np.ndarray, Series, np.ndarray], np.ndarray]
    errors: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    components: tuple[str, ...]


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * angle))


def a3_case(start: float = 1 / 3) -> MachineCase:
    """Ball-bar circles that begin a share of a step after psi = 0.

    There and every 60 degrees a leg turns back; with `start` 0 readings are taken there.
    """
    m = a3_plans.measurement()
    psi = turns() + 2 * np.pi / POINTS * start
    strokes = (0.04, 0.12, 0.20)
    paths = [a3_plans.bar_commands(m, np.full(len(psi), s), psi) for s in strokes]

    def read(theta: np.ndarray, series: Series, driven: np.ndarray) -> np.ndarray:
        read, taught = driven[series.index[:, 0]], driven[series.index[:1, 1]]
        cup = a3.forward(theta[:24], taught).tip + theta[24:]
        return a3.ball_bar_reading(theta[:24], read, cup)

    def errors(p: np.ndarray, q: np.ndarray, command: np.ndarray) -> np.ndarray:
        real = a3.forward(p, q)
        psi, theta, _ = a3.euler(real.R)
        turned = _wrapped(psi - command[:, 1]), theta - command[:, 2]
        return np.column_stack([real.tip[:, 2] - command[:, 0], *turned])

    command = a3_plans.workspace()[::3]
    names = ("z", "psi", "theta")
    name = "a3_head" if start else "a3_turning"
    return MachineCase(name, m, np.array(paths), command, read, errors, names)


def turns() -> np.ndarray:
    """Angles (POINTS FINE,) once around."""
    return np.asarray(2 * np.pi * np.arange(POINTS * FINE) / (POINTS * FINE))


def circles(centres: np.ndarray, radius: float, tilt: np.ndarray) -> np.ndarray:
    """Paths (r, POINTS FINE, dof) around centres, in the plane of x and y."""
    angle = turns()
    paths = np.repeat(centres[:, None], len(angle), axis=1)
    paths[:, :, 0] += radius * np.cos(angle)
    paths[:, :, 1] += radius * np.sin(angle)
    wave = np.sin(2 * angle[None] + np.arange(len(centres))[:, None])
    return np.asarray(paths + wave[:, :, None] * tilt)


def delta_case() -> MachineCase:
    setup = mount(camera.known_frame, "camera", sigma=[SIGMA] * 3)
    m = Measurement(linear_delta.machine, [setup])
    heights = (0.05, 0.2, 0.35)
    centres = np.array([[0.0, 0.0, z] for z in heights])
    paths = circles(centres, 0.12, np.array([0.0, 0.0, 0.03]))

    def pose(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return delta.nozzle(q, p[0], p[1:4], p[4:7], p[7:10])

    def read(theta: np.ndarray, series: Series, driven: np.ndarray) -> np.ndarray:
        return pose(theta, driven).ravel()

    places = [-0.08, 0.0, 0.08]
    grid = [(x, y, z) for x in places for y in places for z in (0.1, 0.3)]
    return MachineCase(
        "linear_delta",
        m,
        paths,
        np.array(grid),
        read,
        lambda p, q, command: pose(p, q) - command,
        ("x", "y", "z"),
    )


def planar_case() -> MachineCase:
    channels = camera.known_frame.channels[1:]
    instrument = dataclasses.replace(
        camera.known_frame,
        channels=channels,
        observe=lambda frames, s, k: camera.known_frame.observe(frames, s, k)[1:],
    )
    m = Measurement(
        planar_2dof.machine, [mount(instrument, "camera", sigma=[SIGMA] * 2)]
    )
    angle = turns()
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    centres = [(-0.7, 0.7), (0.7, 0.7), (0.0, 0.7)]
    sizes = [(0.6, 0.6), (0.6, 0.6), (1.4, 0.7)]
    paths = [np.array(c) + circle * s for c, s in zip(centres, sizes, strict=True)]
    places = np.linspace(-1.2, 1.2, 7)
    grid = [(y, z) for y in places for z in (0.2, 0.75, 1.3)]
    return MachineCase(
        "planar_2dof",
        m,
        np.array(paths),
        np.array(grid),
        lambda theta, series, driven: planar.forward(driven, theta).ravel(),
        lambda p, q, command: planar.forward(q, p) - command,
        ("y", "z"),
    )


def hexapod_case() -> MachineCase:
    setup = mount(camera.known_frame, "camera", sigma=[SIGMA] * 3)
    m = Measurement(hexapod.machine, [setup])
    home = hexapod.machine.home_command
    rise = np.array([-0.05, 0.0, 0.05])
    centres = home + rise[:, None] * (np.arange(6) == 2)
    tilt = np.array([0.0, 0.0, 0.03, 0.15, -0.12, 0.1])
    paths = circles(centres, 0.06, tilt)

    def tips(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        base = np.array(list(hexapod.B.values())) + p[:18].reshape(6, 3)
        local = np.array(list(hexapod.A.values())) + p[18:36].reshape(6, 3)
        start = np.array(list(hexapod.A.values())) + home[:3]
        found = [hexa.forward(row + p[36:42], base, local, start) for row in q]
        return np.array([point for point, _ in found])

    rng = np.random.default_rng(2)
    spans = np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1])
    command = home + spans * rng.uniform(-1.0, 1.0, (20, 6))
    return MachineCase(
        "hexapod",
        m,
        paths,
        command,
        lambda theta, series, driven: tips(theta, driven).ravel(),
        lambda p, q, command: tips(p, q) - command[:, :3],
        ("x", "y", "z"),
    )


CASES: dict[str, Callable[[], MachineCase]] = {
    "a3_head": a3_case,
    "a3_turning": lambda: a3_case(0.0),
    "linear_delta": delta_case,
    "planar_2dof": planar_case,
    "hexapod": hexapod_case,
}
