"""What the study is about: machine, set-ups, versions, drawing; in display units."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Sequence

import numpy as np

from oed import result, units
from oed.arrays import Array
from oed.instrument import Setup
from oed.machine import Machine
from oed.measurement import Measurement, Series
from pkm_studies.resolve import quantities

PACKAGES = (
    "pkm-oed",
    "casadi",
    "numpy",
    "scipy",
    "emcee",
    "arviz-stats",
    "xarray",
    "matplotlib",
    "typst",
)


def machine(machine: Machine) -> result.MachineInfo:
    """Parameter table of the machine."""
    table: list[dict[str, str | float]] = []
    for p in machine.parameters:
        unit = units.display(p.unit)
        row: dict[str, str | float] = {"name": p.name, "about": p.about, "unit": unit}
        table.append(
            row | {"nominal": _in(p.nominal, unit), "tolerance": _in(p.tolerance, unit)}
        )
    return result.MachineInfo(
        machine.name, machine.about, machine.source, table, list(machine.frame)
    )


def setup(machine: Machine, setup: Setup) -> result.SetupInfo:
    """Numbers of a set-up as used."""
    kinds = {s.name: s.unit for s in setup.instrument.settings}
    numbers = {
        quantities.column(k, kinds[k]): shown(v, kinds[k])
        for k, v in setup.settings.items()
    }
    numbers |= {
        f"tool_{n}_mm": _in(v, "mm") for n, v in zip("xyz", setup.tool, strict=True)
    }
    if setup.teach is not None:
        for c, value in zip(machine.command, setup.teach, strict=True):
            numbers[f"teach_{quantities.column(c.name, c.unit)}"] = shown(value, c.unit)
    channels = zip(setup.instrument.channels, setup.sigma, strict=True)
    return result.SetupInfo(
        name=setup.name,
        instrument=setup.instrument.name,
        about=setup.instrument.about + _passes(setup),
        numbers=numbers,
        sigma={
            f"{c.name}_{units.FINE[c.unit]}": _in(s, units.FINE[c.unit])
            for c, s in channels
        },
        unknowns={
            quantities.column(n.name, n.unit): shown(n.tolerance, n.unit)
            for n in setup.nuisances
        },
    )


def _passes(setup: Setup) -> str:
    count = len(setup.protocol.passes)
    if count == 1:
        return ""
    return (
        f"; {count} passes,"
        f" {'their mean is the reading' if setup.protocol.average else 'all kept'}"
    )


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that make the numbers."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        found[name] = importlib.metadata.version(name)
    return found


def shown(value: float, si: str) -> float:
    """An SI value in the unit a person writes it in (`quantities.column`)."""
    return _in(value, "deg" if si == "rad" else units.display(si))


def command(machine: Machine, values: Array) -> dict[str, float]:
    """A command (n_dof,) in user units, empty where only joints are known."""
    pairs = zip(machine.command, values, strict=True)
    return {
        quantities.column(c.name, c.unit): shown(float(v), c.unit)
        for c, v in pairs
        if np.isfinite(v)
    }


def drawing(measurement: Measurement, series: Sequence[Series]) -> result.Drawing:
    """The machine at home, and where the tool is at each reading."""
    kinematics, machine = measurement.kinematics, measurement.machine
    x, q = kinematics.inverse(machine.home_command)
    lines = [
        result.Polyline("machine", _points(line))
        for line in kinematics.skeleton(x[0], q[0], machine.nominal)
    ]
    tips, owners, bars = [], [], []
    for s in series:
        chosen = measurement.setups[s.setup]
        _, point, _ = kinematics.frames(
            measurement.poses(s, measurement.nominal), np.array(chosen.tool)
        )
        for row in s.index:
            tips.append([float(v) for v in point[row[0]]])
            owners.append(s.setup)
            far = _far_end(chosen, point, row)
            if far is not None:
                bars.append([far, tips[-1]])
    return result.Drawing(lines, tips, owners, bars)


def _far_end(setup: Setup, point: Array, row: Array) -> list[float] | None:
    """Where the other end of what is measured sits, if it is a place."""
    if len(row) == 2:
        return [float(v) for v in point[row[1]]]
    place = [setup.settings.get(f"at_{n}") for n in "xyz"]
    return None if None in place else [float(v) for v in place if v is not None]


def _points(line: Array) -> list[list[float]]:
    return [[float(v) for v in row] for row in line]


def _in(value: float, unit: str) -> float:
    # twelve digits: enough for any reading, and no rounding noise of the unit
    # conversion in what people see
    return float(f"{float(units.from_si(value, unit)):.12g}")
