"""The A3 head as its paper measured it: set-ups, plans and the paper's scaling."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from reference import tian_2016 as paper

from oed.identifiability import identifiability, information
from oed.identifiability.identifiability import Identifiability
from oed.measurement.fixed_reading import commands_at_fixed_reading
from oed.measurement.measurement import Measurement, Series
from oed.model.instrument import mount
from oed.model.machine import Machine
from pkm_models.instruments import ball_bar, camera, orientation
from pkm_models.machines.a3_head import machine

HOME_Z = paper.C + paper.D
STROKES = (0.080, 0.200)


def with_tolerances(tolerances: Mapping[str, float]) -> Machine:
    """The machine with other tolerances (SI), by the beginnings of names."""
    parameters = []
    for p in machine.parameters:
        matching = [t for start, t in tolerances.items() if p.name.startswith(start)]
        tolerance = matching[0] if matching else p.tolerance
        parameters.append(dataclasses.replace(p, tolerance=tolerance))
    return machine.with_parameters(parameters)


def measurement(
    *, taught: bool = True, tools: Sequence[float] = (0.0,), of: Machine = machine
) -> Measurement:
    """One ball bar set-up for each tool length (m).

    Its name is `cup` for the reference tool, and `cup<mm>` for longer ones.
    """
    setups = []
    for tool in tools:
        name, z = f"cup{1e3 * tool:.0f}" if tool else "cup", paper.TEACH_Z + tool
        longer = (0.0, 0.0, tool)
        if taught:
            setups.append(
                mount(ball_bar.instrument, name, tool=longer, teach=(z, 0.0, 0.0))
            )
        else:
            setups.append(
                mount(ball_bar.free_cup, name, tool=longer, at_x=0.0, at_y=0.0, at_z=z)
            )
    return Measurement(of, setups)


def approach_1() -> Measurement:
    """Taught cup, home point and home orientation; no parameter is held (Eqs. 13-14)."""
    free = dataclasses.replace(machine, frame=())
    setups = [
        mount(ball_bar.instrument, "cup", teach=(paper.TEACH_Z, 0.0, 0.0)),
        mount(camera.known_frame, "home_point", sigma=(0.5e-6,) * 3),
        mount(orientation.instrument, "home_orientation"),
    ]
    return Measurement(free, setups)


def home_series(m: Measurement) -> list[Series]:
    """The six rows at home: three of the point, three of the orientation."""
    home = m.machine.home_command[None]
    return [m.series(name, home) for name in ("home_point", "home_orientation")]


def bar_commands(
    m: Measurement, stroke: np.ndarray, psi: np.ndarray, setup: str = "cup"
) -> np.ndarray:
    """Commands (n, 3) at which the bar keeps its length.

    theta follows from stroke (m) and psi (rad).
    """
    z = HOME_Z + m.setups[setup].tool[2] + stroke
    command, possible = commands_at_fixed_reading(
        m, setup, np.column_stack([z, psi, 0.0 * psi]), "theta"
    )
    assert possible.all()
    return command


def circles(
    m: Measurement, points: int, setup: str = "cup", strokes: Sequence[float] = STROKES
) -> Series:
    """The paper's plan: `points` a circle from psi = 0."""
    stroke = np.repeat(strokes, points)
    circle = 2 * np.pi * np.arange(points) / points
    psi = np.tile(circle, len(strokes))
    return m.series(setup, bar_commands(m, stroke, psi, setup))


def grid(m: Measurement, setup: str = "cup") -> np.ndarray:
    """Commands (1512, 3) of the 21 strokes x 72 angles."""
    stroke, psi = np.meshgrid(np.linspace(0, 0.2, 21), np.arange(72) * np.pi / 36)
    return bar_commands(m, stroke.ravel(), psi.ravel(), setup)


def rows(
    m: Measurement, series: Sequence[Series], scaling: information.Scaling = "length"
) -> np.ndarray:
    """Scaled H (N, n_free) at nominal."""
    return information.scaled(m, series, m.nominal, scaling)[:, m.free]


def analyse(
    m: Measurement, series: Sequence[Series]
) -> tuple[Identifiability, list[str], np.ndarray]:
    """Identifiability of the free parameters as lengths.

    Returns with it the lost motions in words, and the remaining null space.
    """
    scale = 1.0 / m.length_factors[m.free]
    names = [name for name, is_free in zip(m.names, m.free, strict=True) if is_free]
    identifiable = identifiability.analyse(rows(m, series), names, scale)
    motions, remaining = identifiability.lost_motions(identifiable, m.machine, scale)
    return identifiable, motions, remaining


def workspace() -> np.ndarray:
    """Commands (144, 3): strokes 0, 100, 200 mm, theta 5, 15, 25, 35 deg, 12 psi."""
    strokes, tilts = [0, 0.1, 0.2], np.deg2rad([5, 15, 25, 35])
    turns = 2 * np.pi * np.arange(12) / 12
    stroke, theta, psi = np.meshgrid(strokes, tilts, turns)
    return np.column_stack([HOME_Z + stroke.ravel(), psi.ravel(), theta.ravel()])


def table_3(m: Measurement) -> np.ndarray:
    """Table 3 as theta of a measurement with the set-up `cup`, SI."""
    theta = m.nominal.copy()
    for name, value in paper.TABLE_3_MM.items():
        theta[m.names.index(name)] = 1e-3 * value
    for name, value in paper.TABLE_3_DEG.items():
        theta[m.names.index(name)] = np.deg2rad(value)
    return theta
