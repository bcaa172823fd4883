"""Twenty-four blunders of a workshop, each made in readings of independent machines.

The machines are those of `tests/oracles`: an A3 head with a taught ball bar in two
set-ups, and a planar machine with two relative channels. A blunder changes readings,
or the commands that are written next to them, and states what a check must say.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from oracles import a3_geometry as a3
from oracles import planar_geometry as planar

from oed import checks
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import ball_bar, relative
from pkm_models.machines import a3_head, planar_2dof

Array = NDArray[np.float64]
Change = Callable[["Readings"], "Readings"]

SIGMA, POINTS, LENGTH = 0.5e-6, 12, 0.3
#: set-up: tool, heights of the circles, teach height (m)
SETUPS = {
    "cup": (0.0, (1.146, 1.266), 1.286),
    "long_tool": (0.1, (1.246, 1.366), 1.386),
}
MM, UM, DEG = 1e-3, 1e-6, np.pi / 180.0
#: row of a file that the first reading is in
FIRST_ROW = 2


@dataclasses.dataclass(frozen=True)
class Readings:
    """What is written into a file: commands (n, 3) by set-up, readings (N,), SI."""

    command: dict[str, Array]
    y: Array
    y_of_another_machine: Array

    def with_y(self, y: Array) -> Readings:
        return dataclasses.replace(self, y=y)


@dataclasses.dataclass(frozen=True)
class Blunder:
    """A blunder: its name, how it is made, and what a check must say of it.

    sentence  words of the finding; "" where the readings cannot reveal the blunder
    rows      rows of the file that must be named; empty where all are at fault
    """

    name: str
    make: Change
    sentence: str
    rows: tuple[int, ...] = ()
    machine: str = "a3"


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


@functools.cache
def planar_measurement() -> Measurement:
    return Measurement(planar_2dof.machine, [mount(relative.rm5, "square")])


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
    other = a3_lengths(a3_errors(rng), rng) + SIGMA * rng.standard_normal(len(y))
    command = {name: a3_commands(name) for name in SETUPS}
    return Readings(command, y, other)


def planar_readings(seed: int) -> Readings:
    """dy and dz of lines across the workspace, each against its line's first pose."""
    rng = np.random.default_rng([2027, seed])
    measurement = planar_measurement()
    pose, line = planar.lines(5)
    p = measurement.nominal[:7] + measurement.tolerance[:7] * rng.standard_normal(7)
    at = planar.forward(planar.inverse(pose), p)
    noise = 1e-6 * rng.standard_normal(at.shape) * np.array([1.0, 3.0])
    y = planar.relative(at + noise, line).ravel()
    return Readings({"square": pose}, y, y)


def session(machine: str, readings: Readings) -> checks.SessionReadings:
    """The session of a file with these readings."""
    measurement = a3_measurement() if machine == "a3" else planar_measurement()
    series = []
    for setup, command in readings.command.items():
        if machine == "a3":
            run = [f"{setup} {k // POINTS + 1}" for k in range(len(command))]
        else:
            run = [f"line {k}" for k in planar.lines(5)[1]]
        series.append(measurement.series(setup, command, run))
    return checks.session(measurement, series, readings.y)


def check(machine: str, readings: Readings) -> checks.CheckedSession:
    one = session(machine, readings)
    alternatives = checks.Alternatives(one.measurement)
    return checks.check_session(one, alternatives, np.random.default_rng(0))


# -- how each blunder is made ----------------------------------------------------------


def values(change: Callable[[Array], Array]) -> Change:
    """A blunder in the readings alone."""
    return lambda readings: readings.with_y(np.asarray(change(readings.y.copy())))


def commands(change: Callable[[Array], Array]) -> Change:
    """A blunder in the commands next to the readings."""

    def make(readings: Readings) -> Readings:
        changed = {name: change(c.copy()) for name, c in readings.command.items()}
        return dataclasses.replace(readings, command=changed)

    return make


def at(rows: tuple[int, ...], amount: Callable[[Array], Array]) -> Change:
    """Readings of some rows of the file, changed."""
    members = [row - FIRST_ROW for row in rows]

    def change(y: Array) -> Array:
        y[members] = amount(y[members])
        return y

    return values(change)


def runs(change: Callable[[Array], Array]) -> Change:
    """Each run of the A3's session, changed."""
    return values(lambda y: np.concatenate([change(r) for r in y.reshape(-1, POINTS)]))


def two_machines(readings: Readings) -> Readings:
    y = readings.y.copy()
    y[20:] = readings.y_of_another_machine[20:]
    return readings.with_y(y)


def exchanged_setups(readings: Readings) -> Readings:
    """Rows of each set-up under the name of the other."""
    names = list(readings.command)
    command = dict(zip(names, [readings.command[n] for n in names[::-1]], strict=True))
    y = np.roll(readings.y, len(readings.y) // 2)
    return dataclasses.replace(readings, command=command, y=y)


def nominal(readings: Readings) -> Readings:
    return readings.with_y(np.full_like(readings.y, LENGTH))


def exchanged_columns(y: Array) -> Array:
    return y.reshape(-1, 2)[:, ::-1].ravel()


def dy_reversed(y: Array) -> Array:
    return (y.reshape(-1, 2) * [-1.0, 1.0]).ravel()


BLUNDERS = [
    Blunder("um in a column of mm", values(lambda y: 1e3 * y), "are in um, not in mm"),
    Blunder("m in a column of mm", values(lambda y: 1e-3 * y), "are in m, not in mm"),
    Blunder("inches", values(lambda y: y / 25.4), "are in inch, not in mm"),
    Blunder(
        "deviations in place of lengths",
        values(lambda y: y - LENGTH),
        "are deviations from the nominal length",
    ),
    Blunder(
        "deviations in um",
        values(lambda y: 1e3 * (y - LENGTH)),
        "are deviations from the nominal length in um",
    ),
    Blunder(
        "length added to lengths",
        values(lambda y: y + LENGTH),
        "the nominal length added twice",
    ),
    Blunder(
        "sign of the bar's deviation",
        values(lambda y: 2.0 * LENGTH - y),
        "the sign of the deviations of length_mm from the nominal length is reversed",
    ),
    Blunder(
        "columns exchanged",
        values(exchanged_columns),
        "the columns dy_mm and dz_mm are exchanged",
        machine="planar",
    ),
    Blunder(
        "sign of a channel",
        values(dy_reversed),
        "the sign of dy_mm is reversed",
        machine="planar",
    ),
    Blunder(
        "readings one row late",
        values(lambda y: np.roll(y, 1)),
        "the readings stand in the file 1 row too late",
    ),
    Blunder(
        "runs read backward",
        runs(lambda r: r[::-1]),
        "the readings of each run are in reversed order",
    ),
    Blunder(
        "set-ups exchanged",
        exchanged_setups,
        "the set-ups cup and long_tool are exchanged",
    ),
    Blunder(
        "circles start at 90 deg",
        commands(lambda c: c + np.array([0.0, 90.0 * DEG, 0.0])),
        "psi_deg starts 90 deg from where it should",
    ),
    Blunder(
        "two rows exchanged",
        values(lambda y: y[np.r_[:6, 15, 7:15, 6, 16 : len(y)]]),
        "Rows 8 and 17 look exchanged",
        (8, 17),
    ),
    Blunder(
        "one reading off by 50 sigma",
        at((19,), lambda y: y + 50 * SIGMA),
        "Row 19, column length_mm",
        (19,),
    ),
    Blunder(
        "three readings off by 10 sigma",
        at((5, 30, 40), lambda y: y + 10 * SIGMA),
        "sigma from the",
        (5, 30, 40),
    ),
    Blunder(
        "a point lost in one number",
        at((11,), lambda y: 10.0 * y),
        "Row 11, column length_mm = 30",
        (11,),
    ),
    Blunder(
        "a reading copied into the next rows",
        at((21, 22, 23), lambda y: y[[0, 0, 0]]),
        "equal to the last digit at other poses",
        (21, 22, 23),
    ),
    Blunder("computed, not measured", nominal, "of the nominal machine to within"),
    Blunder(
        "half from another machine",
        two_machines,
        "the readings up to row 21 and those from row 22 fit alone but not together",
    ),
    Blunder(
        "bar longer by 0.5 mm",
        values(lambda y: y + 0.5 * MM),
        "all readings of length_mm are off by",
    ),
    Blunder(
        "rounded to 0.01 mm",
        values(lambda y: np.round(y, 5)),
        "All readings of length_mm are multiples of 0.01",
    ),
    Blunder(
        "smoothed readings",
        lambda r: a3_readings(0, 0.1 * SIGMA),
        "The residuals are only",
    ),
    Blunder("sign of psi", commands(lambda c: c * [1.0, -1.0, 1.0]), ""),
]
