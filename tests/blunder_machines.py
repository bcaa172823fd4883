"""Readings files of five independent machines, and what a check finds in them.

The machines are those of `tests/oracles`; a drawn one has errors of one tolerance.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from blunder_spatial import (
    delta_measurement,
    delta_readings,
    hexapod_measurement,
    hexapod_readings,
    prs_measurement,
    prs_readings,
    redriven_prs,
)
from blunder_tables import DEG, MM, UM, Array, VirtualMachine, noise, offsets, table
from oracles import a3_geometry as a3
from oracles import planar_geometry as planar

from oed import checks, dataset
from oed.measurement.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import ball_bar, relative
from pkm_models.machines import a3_head, planar_2dof

# -- A3 head, ball bar in two or three set-ups --------------------------------------------------

POINTS, LENGTH, BAR_NOISE = 12, 0.3, 0.5 * UM
#: set-up: tool, heights of the circles, teach height (m)
BARS = {
    "cup": (0.0, (1.176, 1.266), 1.286),
    "long_tool": (0.1, (1.186, 1.256), 1.386),
    "mid_tool": (0.05, (1.176, 1.256), 1.336),
}
TWO_BARS, THREE_BARS = ("cup", "long_tool"), ("cup", "long_tool", "mid_tool")
#: errors of the base joints that do not choose the frame
FREE_BASE = np.array([[0, 1, 0], [1, 0, 0], [1, 0, 0]])


@functools.cache
def a3_measurement(names: tuple[str, ...] = TWO_BARS) -> Measurement:
    setups = [
        mount(
            ball_bar.instrument,
            name,
            tool=(0.0, 0.0, tool),
            teach=(teach, 0.0, 0.0),
            sigma=[BAR_NOISE],
        )
        for name, (tool, _, teach) in BARS.items()
        if name in names
    ]
    return Measurement(a3_head.machine, setups)


def a3_circle(setup: str, z: float) -> Array:
    """Commands (n, 3) of a circle on which the bar of 300 mm leads the tool."""
    tool, _, teach = BARS[setup]
    psi = np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False)
    theta = a3.circle_theta(z, psi, np.array([0.0, 0.0, teach]), LENGTH, tool)
    return np.column_stack([np.full(POINTS, z), psi, theta])


def a3_errors(rng: np.random.Generator) -> Array:
    """Errors (24,) of a machine: 1 mm and 0.01 rad, one standard deviation."""
    return np.asarray(
        a3.errors(
            dq=1e-3 * rng.standard_normal(3),
            db=1e-3 * rng.standard_normal((3, 3)) * FREE_BASE,
            da0=1e-3 * rng.standard_normal((3, 3)),
            beta=0.01 * rng.standard_normal(3),
        )
    )


def a3_lengths(
    p: Array, setup: str, cup: Array, command: Array, longer: float = 0.0
) -> Array:
    """Lengths (n,) at the joints of commands (n, 3), m; the tool may be longer."""
    tool, _, teach = BARS[setup]
    z, psi, theta = command.T
    q = a3.inverse_nominal(z, psi, theta, tool=tool)
    home = a3.inverse_nominal(teach, 0.0, 0.0, tool=tool)
    at = a3.forward(p, home, tool + longer).tip + cup
    tip = a3.forward(p, q, tool + longer).tip
    return np.asarray(np.linalg.norm(tip - at, axis=-1))


def a3_readings(
    rng: np.random.Generator, law: str, names: tuple[str, ...] = TWO_BARS
) -> pd.DataFrame:
    p = a3_errors(rng)
    parts, cups, errors = [], {}, []
    for setup in names:
        heights = BARS[setup][1]
        command = np.vstack([a3_circle(setup, z) for z in heights])
        run = [f"{setup} {1 + k // POINTS}" for k in range(len(command))]
        cup = 20 * UM * rng.standard_normal(3)
        y = a3_lengths(p, setup, cup, command)
        error = BAR_NOISE * noise(rng, law, np.array(run))
        cups[setup], y = cup, y + error
        errors.append(error / MM)
        columns = {
            "z_mm": command[:, 0] / MM,
            "psi_deg": command[:, 1] / DEG,
            "theta_deg": command[:, 2] / DEG,
            "length_mm": y / MM,
        }
        parts.append(table(setup, run, columns))
    rows = pd.concat(parts, ignore_index=True)
    rows.attrs = {"p": p, "cups": cups, "noise": np.concatenate(errors)}
    return rows


def redriven_a3(
    rows: pd.DataFrame,
    *,
    run: str = "",
    setup_of_rows: str = "",
    setup: str = "",
    dz: float = 0.0,
    own_tilts: bool = False,
    cup: tuple[float, float, float] = (0.0, 0.0, 0.0),
    longer: float = 0.0,
) -> pd.DataFrame:
    """Rows whose readings are of a machine driven otherwise, with the same errors.

    run, setup_of_rows  which rows; all by default
    setup               in which set-up they were taken; their own by default
    dz, cup, longer     how much higher (mm), cup elsewhere and tool longer (m)
    own_tilts           whether the tilts are those of the circle at that height
    """
    changed = rows.copy()
    for name in BARS:
        at = (rows["setup"] == name).to_numpy(copy=True)
        at &= (not run) | (rows["run"] == run).to_numpy()
        if not at.any() or setup_of_rows not in ("", name):
            continue
        used = setup or name
        command = rows.loc[at, ["z_mm", "psi_deg", "theta_deg"]].to_numpy()
        command = (command + np.array([dz, 0.0, 0.0])) * [MM, DEG, DEG]
        if own_tilts:
            command = a3_circle(used, command[0, 0])
        place = rows.attrs["cups"][used] + np.array(cup)
        y = a3_lengths(rows.attrs["p"], used, place, command, longer)
        changed.loc[at, "length_mm"] = y / MM + rows.attrs["noise"][at]
    changed["length_mm"] = changed["length_mm"].round(4)
    return changed


# -- planar machine, lines against a ruler and a square --------------------------------


@functools.cache
def planar_measurement() -> Measurement:
    setups = [mount(relative.rm5, "ruler"), mount(relative.rm4, "square")]
    return Measurement(planar_2dof.machine, setups)


def planar_readings(rng: np.random.Generator, law: str) -> pd.DataFrame:
    """dy and dz along lines, each against its line's first pose."""
    tolerance = planar_measurement().tolerance[:7]
    p = planar.NOMINAL + tolerance * rng.standard_normal(7)
    parts = []
    for setup, number, sigma in (("ruler", 5, [1.0, 3.0]), ("square", 4, [3.0])):
        pose, line = planar.lines(number)
        at = planar.forward(planar.inverse(pose), p)[:, : len(sigma)]
        run = np.array([f"{setup} {k + 1}" for k in line])
        first = np.array([np.flatnonzero(line == k)[0] for k in line])
        is_read = first != np.arange(len(line))
        columns = {"y_mm": pose[:, 0] / MM, "z_mm": pose[:, 1] / MM}
        for k, name in enumerate(("dy_mm", "dz_mm")[: len(sigma)]):
            is_offset = law == "run offsets"
            error = noise(rng, "white" if is_offset else law, run)
            error = error - error[first]
            if is_offset:  # of the readings of a line, against its reference
                error = error + offsets(rng, run)
            value = at[:, k] - at[first, k] + sigma[k] * UM * error
            columns[name] = np.where(is_read, value, np.nan) / MM
        parts.append(table(setup, list(run), columns))
    return pd.concat(parts, ignore_index=True)


__all__ = ["check", "readings", "redriven_a3", "redriven_prs", "session"]

MACHINES = {
    "a3": VirtualMachine(a3_measurement, a3_readings),
    "planar": VirtualMachine(planar_measurement, planar_readings),
    "hexapod": VirtualMachine(hexapod_measurement, hexapod_readings),
    "delta": VirtualMachine(delta_measurement, delta_readings),
    "prs": VirtualMachine(prs_measurement, prs_readings),
    "a3 in three set-ups": VirtualMachine(
        functools.partial(a3_measurement, THREE_BARS),
        functools.partial(a3_readings, names=THREE_BARS),
    ),
}


def readings(machine: str, seed: int, law: str = "white") -> pd.DataFrame:
    """The table of a drawn machine; that of another one is in its `attrs`."""
    return _drawn(machine, seed, law).copy()


@functools.cache
def _drawn(machine: str, seed: int, law: str) -> pd.DataFrame:
    rng = np.random.default_rng([2031, seed, list(MACHINES).index(machine)])
    rows = MACHINES[machine].readings(rng, law)
    rows.attrs["other"] = MACHINES[machine].readings(rng, law)
    return rows


def session(machine: str, rows: pd.DataFrame) -> checks.SessionReadings:
    """The session of a file with these rows, as `oed check` reads it."""
    measurement = MACHINES[machine].measurement()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "some.readings.csv"
        rows.to_csv(path, index=False, float_format="%.10g")
        data = dataset.load(path, measurement)
    used = tuple(dict.fromkeys(s.setup for s in data.series))
    return checks.session(
        _with_setups(machine, used),
        data.series,
        data.y,
        data.covariates,
        data.columns,
    )


@functools.cache
def _with_setups(machine: str, names: tuple[str, ...]) -> Measurement:
    measurement = MACHINES[machine].measurement()
    return measurement.with_setups([measurement.setups[name] for name in names])


def check(machine: str, rows: pd.DataFrame) -> checks.CheckedSession:
    """What a check finds in these rows."""
    measurement = MACHINES[machine].measurement()
    rng = np.random.default_rng(0)
    return checks.check_session(session(machine, rows), measurement, rng)
