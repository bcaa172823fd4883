"""Machines with small effects, drawn by the second generator, and what they do at their poses."""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness.diagnosis import bench as bench_of
from benchmarks.second.world import GENERATOR, MACHINES, write_case
from oed import dataset
from oed.base import Array
from oed.effect_model import Effect
from oed.measurement import Measurement

MM = 1e-3
HEALTHY = (0.6, 1.4)
LEVELS = ("rigid", "healthy")  #: levels of the effects that all machines have
SPREAD = 0.7  #: spread of the logarithm of an effect's size


@dataclasses.dataclass(eq=False)
class Bench:
    """A drawn machine, read.

    measurement, series, y, covariates, gravity, effects   what a user has
    command  (n, n_dof) commanded poses, SI; tool (n, 3) of each
    shift    (n, 3) true displacement of the tool point at the nominal joints, m
    """

    measurement: Measurement
    series: tuple[Any, ...]
    y: Array
    covariates: Any
    gravity: Any
    effects: tuple[Effect, ...]
    command: Array
    tool: Array
    shift: Array
    case: Any
    setup_names: Any = None
    times: Any = None


def draw(machine: str, size: float, level: str, seed: int) -> Bench:
    """A machine with all effects small, and one of sqrt(lambda) `size` (0: none).

    level   "healthy": all effects together of sqrt(lambda) .6 to 1.4; "rigid": none
    """
    sys.path.insert(0, str(GENERATOR))
    import make  # the generator's own modules
    from design import design
    from effects import LAWS, LISTED, noise
    from oracle import Oracle
    from truth import Pert

    key = [seed, MACHINES.index(machine), round(size), LEVELS.index(level)]
    rng = np.random.default_rng(key)
    c = design(machine, rng, False)
    geometry = Pert()
    for _, sd, P in c.params():
        geometry = geometry + P * (sd * rng.normal())
    law = "white" if level == "rigid" else str(rng.choice(LAWS))
    errors, sigma, _ = noise(c, rng, law)
    oracle = Oracle(c, geometry, sigma)
    total = Pert()
    if level == "healthy":
        total = _small_effects(machine, c, oracle, rng)
    name = ""
    if size:
        name, f, _, a, *_ = make.sized(c, rng, oracle, LISTED, machine, size)
        total = total + f(a)
    y = np.round(c.readings(geometry + total) + errors, 6)
    x, R = c.solve(geometry + total)
    P = geometry + total
    tip = x + np.einsum("nij,nj->ni", R, np.broadcast_to(P.f("T"), (c.n, 3))) + P.f("X")
    c.sensed = make.sensors(c, rng)
    with tempfile.TemporaryDirectory() as folder:
        stem = Path(folder) / "case"
        make.write(c, y, {"kind": "single"}, stem)
        path, readings = write_case(stem, Path(folder) / "study")
        measurement, effects, gravity = bench_of(path)
        data = dataset.load(readings, measurement)
    tools = np.array([q.get("tool_mm", 0.0) for q in c.setups])[c.setup] * MM
    return Bench(
        measurement=measurement,
        series=data.series,
        y=data.y,
        covariates=data.covariates,
        gravity=gravity,
        effects=effects,
        command=_command(measurement.machine, c),
        tool=np.column_stack([0 * tools, 0 * tools, tools]),
        shift=(tip - c.x0) * MM,
        case=dict(name=name, law=law),
        setup_names=[c.setups[k]["name"] for k in c.setup],
        times=c.t,
    )


def _small_effects(machine, c, oracle, rng):
    """All effects of the machine's kind, together of a size of `HEALTHY`."""
    from effects import LISTED
    from truth import Pert

    parts = []
    for make_effect, machines in LISTED.values():
        if machine in machines:
            f, _ = make_effect(c, rng)
            amount, *_ = oracle.size(f, 1.0)
            parts.append((f, amount * np.exp(rng.normal(0, SPREAD))))
    wanted = rng.uniform(*HEALTHY)
    scale = 1.0
    for _ in range(8):
        total = Pert()
        for f, amount in parts:
            total = total + f(amount * scale)
        scale *= wanted / max(oracle.lam(oracle.signature(total)), 1e-9)
    return total


def _command(machine, c):
    values = []
    for coordinate in machine.command:
        unit = MM if coordinate.unit == "m" else np.pi / 180
        suffix = "mm" if coordinate.unit == "m" else "deg"
        column = c.cmd.get(f"{coordinate.name}_{suffix}")
        values.append(
            np.zeros(c.n) if column is None else np.asarray(column, float) * unit
        )
    return np.column_stack(values)


def displacement(bench: Bench, theta: Array) -> Array:
    """Displacements (m, n, 3) of the tool point at the nominal joints with theta (m, np)."""
    kinematics = bench.measurement.kinematics
    nominal = kinematics.machine.nominal
    result = np.zeros((len(theta), len(bench.command), 3))
    for tool in np.unique(bench.tool, axis=0):
        rows = np.flatnonzero((bench.tool == tool).all(axis=1))
        x, q = kinematics.inverse(bench.command[rows], nominal, tool)
        _, start, _ = kinematics.frames(x, tool)
        reached, _ = kinematics.try_forward(q, theta, x)
        _, point, _ = kinematics.frames(reached.reshape(-1, x.shape[1]), tool)
        result[:, rows] = point.reshape(len(theta), len(rows), 3) - start
    return result


def free_of_frame(points: Array, error: Array, components: Array) -> Array:
    """Errors (m, n, 3) without their best small rigid motion."""
    basis = [np.broadcast_to(np.eye(3)[k], points.shape) for k in components]
    centred = points - points.mean(axis=0)
    axes = range(3) if len(components) == 3 else [0]
    basis += [np.cross(np.eye(3)[k], centred) for k in axes]
    B = np.stack([b[:, components].ravel() for b in basis], axis=1)
    U, s, _ = np.linalg.svd(B, full_matrices=False)
    U = U[:, s > 1e-9 * s[0]]
    flat = error[..., components].reshape(*error.shape[:-2], -1)
    flat = flat - (flat @ U) @ U.T
    return flat
