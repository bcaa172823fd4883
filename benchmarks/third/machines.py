"""Three machines in plain NumPy: joints to tool point, and the sessions that read them.

Geometry comes as departures `theta` from nominal, with the tolerances `sd` that the
models of the toolkit state. The closures share no code with the toolkit.

A machine has a name, as `benchmarks.second.world` calls it, `legs` drives, a platform
of `weight` N, and an instrument with noise `sigma`, m. `joints` gives joint values (n,
legs) of commands (n, 3) and (n, 2); `tips` the tool points (n, 3) of joint values, of a
base that has grown by `frame` (n,).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.oracles import delta_trilateration, planar_geometry

Array = NDArray[np.float64]


class Planar:
    """Two sliders, two struts: y and z. theta: D, zeros, lengths, tilts."""

    name, legs, sigma, weight = "planar", 2, 3e-6, 900.0
    sd = np.array([0.5e-3] * 5 + [0.3e-3] * 2)

    def joints(self, points: Array, tilts: Array) -> Array:
        return np.asarray(planar_geometry.inverse(points[:, 1:]))

    def tips(self, s: Session, q: Array, theta: Array, frame: Array) -> Array:
        p = np.tile(planar_geometry.NOMINAL + theta, (len(q), 1))
        p[:, 0] *= 1.0 + frame
        yz = planar_geometry.forward(q, p)
        return np.column_stack([np.zeros(len(q)), yz])


class Delta:
    """Three upright towers. theta: a row a tower of zero, arm, radius, tangent, tilts."""

    name, legs, sigma, weight = "delta", 3, 1e-6, 60.0
    sd = np.tile([0.5e-3, 0.3e-3, 0.3e-3, 0.3e-3, 1e-3, 1e-3], 3)
    radius, arm = 0.16175, 0.345
    angles = np.radians([210.0, 330.0, 450.0])
    outwards = np.stack([np.cos(angles), np.sin(angles), 0 * angles], -1)
    across = np.stack([-np.sin(angles), np.cos(angles), 0 * angles], -1)

    def joints(self, points: Array, tilts: Array) -> Array:
        flat = points[:, None, :2] - self.radius * self.outwards[:, :2]
        return np.asarray(points[:, 2:] + np.sqrt(self.arm**2 - (flat**2).sum(-1)))

    def tips(self, s: Session, q: Array, theta: Array, frame: Array) -> Array:
        zero, arm, radius, tangent, tilt_x, tilt_y = theta.reshape(3, 6).T
        axis = np.stack([tilt_x, tilt_y, np.ones(3)], -1)
        axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        out = (self.radius * (1.0 + frame[:, None]) + radius)[..., None] * self.outwards
        centres = out + tangent[:, None] * self.across + (q + zero)[..., None] * axis
        return np.asarray(delta_trilateration.lower_point(centres, self.arm + arm))


class Hexapod:
    """Six legs from a base above. theta: zeros, base joints, platform joints."""

    name, legs, sigma, weight = "hexapod", 6, 0.7e-6, 400.0
    sd = np.array([0.3e-3] * 6 + [0.1e-3] * 36)

    def __init__(self) -> None:
        self.base = _circle(0.55, (-12, 12, 108, 132, 228, 252), 0.0)
        self.platform = _circle(0.21, (-48, 48, 72, 168, 192, 288), 0.14)

    def joints(self, points: Array, tilts: Array) -> Array:
        tops = points[:, None] + self.platform @ _tilted(tilts).swapaxes(1, 2)
        return np.asarray(np.linalg.norm(tops - self.base, axis=-1))

    def tips(self, s: Session, q: Array, theta: Array, frame: Array) -> Array:
        lengths = q + theta[:6]
        base = self.base * (1.0 + frame[:, None, None]) + theta[6:24].reshape(6, 3)
        local = self.platform + theta[24:].reshape(6, 3)
        tip, rotation = s.points.copy(), _tilted(s.tilts)
        for _ in range(5):
            arms = local @ rotation.swapaxes(1, 2)
            legs = tip[:, None] + arms - base
            norms = np.linalg.norm(legs, axis=-1)
            unit = legs / norms[..., None]
            slope = np.concatenate([unit, np.cross(arms, unit)], -1)
            step = np.linalg.solve(slope, (lengths - norms)[..., None])[..., 0]
            tip += step[:, :3]
            rotation = _turn(step[:, 3:]) @ rotation
        return tip


def _circle(radius: float, degrees: tuple[int, ...], z: float) -> Array:
    angle = np.radians(degrees)
    heights = np.full(len(angle), z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), heights], -1)


def _turn(vectors: Array) -> Array:
    """Rotations (n, 3, 3) by vectors (n, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=-1)[:, None, None] + 1e-300
    x, y, z = (vectors / angle[..., 0]).T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew


def _tilted(tilts: Array) -> Array:
    """Orientations Rx(alpha) Ry(beta) of commands (n, 2)."""
    zero = np.zeros(len(tilts))
    about_x = _turn(np.stack([tilts[:, 0], zero, zero], -1))
    return about_x @ _turn(np.stack([zero, tilts[:, 1], zero], -1))


Machine = Planar | Delta | Hexapod
MACHINES = (Planar, Delta, Hexapod)
RUNS, SUBSTEPS, LEAD_IN = 10, 24, 0.5
READINGS = {"planar": 11, "delta": 20, "hexapod": 20}  # a run
FEEDS, PAYLOADS = (600.0, 1800.0), (0.0, 80.0)  # mm/min, N


@dataclasses.dataclass(frozen=True)
class Session:
    """Commands of a session: RUNS runs of equally many readings, n in all.

    setups           as case files name them
    run, setup       of each reading, from 0
    points, tilts    commands (n, 3) and (n, 2)
    time, q          s (n,), joints (n, legs)
    direction, feed, payload  of each reading; mm/min, N
    path_time, path_q, path_points  along the motion: (T, RUNS, ...)
    at               where on the motion the readings of a run are
    """

    machine: Machine
    setups: tuple[Mapping[str, Any], ...]
    run: Array
    setup: Array
    points: Array
    tilts: Array
    time: Array
    q: Array
    direction: Array
    feed: Array
    payload: Array
    path_time: Array
    path_q: Array
    path_points: Array
    at: Array

    def of_readings(self, along: Array) -> Array:
        """Values along the motion (T, RUNS, ...) at the readings (n, ...)."""
        return _by_reading(along[self.at])


def _by_reading(values: Array) -> Array:
    """(K, RUNS, ...) as (n, ...), run after run."""
    return np.asarray(values.swapaxes(0, 1).reshape(-1, *values.shape[2:]))


def session(machine: Machine, rng: np.random.Generator) -> Session:
    """Lines of a planar machine, else ball bar circles about two cups."""
    count = READINGS[machine.name]
    steps = np.arange(-int(LEAD_IN * SUBSTEPS), (count - 1) * SUBSTEPS + 1) / SUBSTEPS
    at = np.flatnonzero(np.isclose(steps % 1.0, 0.0) & (steps > -0.1))
    setups = _lines() if machine.name == "planar" else _bars(machine.name, rng)
    of_run = np.repeat([0, 1], RUNS // 2)
    turn = np.where(np.arange(RUNS) % 2, -1.0, 1.0)
    feed = np.array(FEEDS)[np.arange(RUNS) // 2 % 2]
    payload = np.array(PAYLOADS)[(np.arange(RUNS) + 1) // 2 % 2]
    paths = [
        _path(machine.name, setups[of_run[r]], turn[r], steps, count, rng)
        for r in range(RUNS)
    ]
    points, tilts = (np.stack(part, 1) for part in zip(*paths, strict=True))
    joints = machine.joints(points.reshape(-1, 3), tilts.reshape(-1, 2))
    joints = joints.reshape(*points.shape[:2], machine.legs)
    clock = _clock(points, feed, of_run, rng)
    each = np.arange(RUNS).repeat(count)
    return Session(
        machine, setups, each, of_run[each],
        _by_reading(points[at]), _by_reading(tilts[at]), _by_reading(clock[at]),
        _by_reading(joints[at]), turn[each], feed[each], payload[each],
        clock, joints, points, at,
    )  # fmt: skip


def _clock(points: Array, feed: Array, of_run: Array, rng: Any) -> Array:
    """Time (T, RUNS) along the motion, with pauses between runs and set-ups."""
    way = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    took = np.cumsum(way / (feed / 60e3) + 1e-3, axis=0)
    took = np.concatenate([np.zeros((1, RUNS)), took])
    pauses = rng.uniform(200.0, 600.0, RUNS) + 900.0 * (np.diff(of_run, prepend=0) > 0)
    starts = np.cumsum(pauses) + np.concatenate([[0.0], np.cumsum(took[-1])[:-1]])
    return np.asarray(starts + took)


def _lines() -> tuple[dict[str, Any], ...]:
    kinds = (("H", "RM5"), ("V", "RM4"))
    return tuple(
        {"name": n, "instrument": "relative", "measurement": m, "sigma_um": 3.0}
        for n, m in kinds
    )


def _bars(name: str, rng: np.random.Generator) -> tuple[dict[str, Any], ...]:
    length, height, spread = (
        (100.0, 40.0, 30.0) if name == "delta" else (200.0, -800.0, 60.0)
    )
    sigma = 1.0 if name == "delta" else 0.7
    return tuple(
        {
            "name": f"B{k + 1}", "instrument": "ball_bar", "bar_mm": scale * length,
            "cup_mm": [*rng.uniform(-spread, spread, 2), height],
            "tool_mm": 0.0, "sigma_um": sigma,
        }
        for k, scale in enumerate((1.0, 0.75))
    )  # fmt: skip


def _path(
    name: str, setup: Mapping[str, Any], turn: float, steps: Array, count: int, rng: Any
) -> tuple[Array, Array]:
    """Points and tilts along a run. A planar machine stops at each reading."""
    points, tilts = np.zeros((len(steps), 3)), np.zeros((len(steps), 2))
    if name == "planar":
        share = (steps - np.sin(2 * np.pi * steps) / (2 * np.pi)) / (count - 1) - 0.5
        across, along = (2, 1) if setup["measurement"] == "RM5" else (1, 2)
        middle, reach = (0.0, 2.7) if along == 1 else (0.75, 1.3)
        points[:, along] = middle + turn * reach * share
        points[:, across] = rng.uniform(*((0.1, 1.4) if across == 2 else (-1.3, 1.3)))
        return points, tilts
    angle = rng.uniform(0.0, 2 * np.pi) + turn * 2 * np.pi * steps / count
    lift = np.radians(rng.uniform(10.0, 60.0))
    ring = np.cos(lift) * np.stack([np.cos(angle), np.sin(angle)], -1)
    unit = np.column_stack([ring, np.full(len(angle), np.sin(lift))])
    points[:] = 1e-3 * (np.array(setup["cup_mm"]) + setup["bar_mm"] * unit)
    if name == "hexapod":
        phase, size = rng.uniform(0.0, 2 * np.pi, 2), np.radians(rng.uniform(2, 8))
        tilts[:] = size * np.cos(angle[:, None] + phase)
    return points, tilts


def change(s: Session, **parts: Array) -> Array:
    """What a fault does to n readings (n, 8 + legs), of the parts that are named.

    reading       added to a bar's reading, m (n,)
    frame         relative growth of the base (n,)
    tool, mount   displacement of tool point and of cup, m (n, 3)
    legs          added to joints, m (n, legs)
    """
    n = len(s.time)
    widths = {"reading": 1, "frame": 1, "tool": 3, "mount": 3, "legs": s.machine.legs}
    none = np.zeros(n)
    columns = [
        np.broadcast_to(parts.get(k, none).reshape(n, -1), (n, width))
        for k, width in widths.items()
    ]
    return np.concatenate(columns, -1)


def readings(s: Session, theta: Array, cups: Array, c: Array) -> Array:
    """Noise-free readings: bar lengths (n, 1); y and z (n, 2) of a planar machine.

    cups (2, 3): departures of the cups from where they are stated
    """
    tip = s.machine.tips(s, s.q + c[:, 8:], theta, c[:, 1]) + c[:, 2:5]
    if s.machine.name == "planar":
        return np.asarray(tip[:, 1:])
    at = 1e-3 * np.array([setup["cup_mm"] for setup in s.setups]) + cups
    away = tip - at[s.setup] - c[:, 5:8]
    return np.asarray(np.linalg.norm(away, axis=-1) + c[:, 0])[:, None]
