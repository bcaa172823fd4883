"""The A3 head as its paper measured it: set-ups, plans and the paper's scaling, through
the kernel.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from reference import tian_2016 as paper

from oed import identifiability, information
from oed.identifiability import Identifiability
from oed.instrument import mount
from oed.machine import Machine
from oed.measurement import Measurement, Series
from pkm_models.instruments import ball_bar
from pkm_models.machines.a3_head import machine

HOME_Z = paper.C + paper.D
STROKES = (0.080, 0.200)


def with_tolerances(tolerances: Mapping[str, float]) -> Machine:
    """The machine with other tolerances (SI) for the parameters whose names begin so."""
    table = []
    for p in machine.parameters:
        given = [t for start, t in tolerances.items() if p.name.startswith(start)]
        table.append(
            dataclasses.replace(p, tolerance=given[0] if given else p.tolerance)
        )
    return machine.with_parameters(table)


def measurement(
    *, taught: bool = True, tools: Sequence[float] = (0.0,), of: Machine = machine
) -> Measurement:
    """One ball bar set-up for each tool length (m): `cup` for the reference tool,
    `cup<mm>` for longer ones.
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


def held(
    m: Measurement, stroke: np.ndarray, psi: np.ndarray, setup: str = "cup"
) -> np.ndarray:
    """Commands (n, 3) at which the bar keeps its length: theta follows from stroke (m)
    and psi (rad).
    """
    z = HOME_Z + m.setups[setup].tool[2] + stroke
    command, possible = m.hold(setup, np.column_stack([z, psi, 0.0 * psi]), "theta")
    assert possible.all()
    return command


def circles(
    m: Measurement, points: int, setup: str = "cup", strokes: Sequence[float] = STROKES
) -> Series:
    """The paper's plan: `points` a circle from psi = 0."""
    stroke = np.repeat(strokes, points)
    return m.series(
        setup,
        held(
            m,
            stroke,
            np.tile(2 * np.pi * np.arange(points) / points, len(strokes)),
            setup,
        ),
    )


def grid(m: Measurement, setup: str = "cup") -> np.ndarray:
    """Commands (1512, 3) of the 21 strokes x 72 angles."""
    stroke, psi = (
        v.ravel()
        for v in np.meshgrid(np.linspace(0, 0.2, 21), np.arange(72) * np.pi / 36)
    )
    return held(m, stroke, psi, setup)


def rows(
    m: Measurement, series: Sequence[Series], scaling: information.Scaling = "length"
) -> np.ndarray:
    """Scaled H (N, n_free) at nominal."""
    return information.scaled(m, series, m.nominal, scaling)[:, m.free]


def verdict(
    m: Measurement, series: Sequence[Series]
) -> tuple[Identifiability, list[str], np.ndarray]:
    """Identifiability of the free parameters as lengths, the lost motions in words, the
    rest of the null space.
    """
    scale = 1.0 / m.lengths[m.free]
    told = identifiability.analyse(
        rows(m, series), [n for n, f in zip(m.names, m.free, strict=True) if f], scale
    )
    return told, *identifiability.lost_motions(told, m.machine, scale)


def workspace() -> np.ndarray:
    """Commands (144, 3): strokes 0, 100, 200 mm, theta 5, 15, 25, 35 deg, 12 psi."""
    stroke, theta, psi = np.meshgrid(
        [0, 0.1, 0.2], np.deg2rad([5, 15, 25, 35]), 2 * np.pi * np.arange(12) / 12
    )
    return np.column_stack([HOME_Z + stroke.ravel(), psi.ravel(), theta.ravel()])


def table_3(m: Measurement) -> np.ndarray:
    """Table 3 as theta of a measurement with the set-up `cup`, SI."""
    theta = m.nominal.copy()
    for name, value in paper.TABLE_3_MM.items():
        theta[m.names.index(name)] = 1e-3 * value
    for name, value in paper.TABLE_3_DEG.items():
        theta[m.names.index(name)] = np.deg2rad(value)
    return theta
