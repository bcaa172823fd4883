"""What instruments read of a tool that stands somewhere, in plain NumPy.

An instrument draws its own place and unknowns within stated tolerances. Its errors come
as unit errors (n, sources) of each reading.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.random_machines.closures import rotations
from benchmarks.random_machines.machines import parameter_errors

Array = np.ndarray
#: channel values (n, channels) from points (n, 3), rotations (n, 3, 3) and unit errors
Read = Callable[[Array, Array, Array], Array]
XYZ = ("x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Mounted:
    """An instrument as mounted.

    table       `[[setup]]` of its study
    noise       its entries of `[noise]`
    channels    columns of the readings
    sources     number of independent errors of a reading
    read        channel values in the columns' units
    reference   whether a run's first pose is its reference, which the others refer to
    """

    table: Mapping[str, Any]
    noise: Mapping[str, float]
    channels: Sequence[str]
    sources: int
    read: Read
    reference: bool = False


@dataclasses.dataclass(frozen=True)
class Bench:
    """Where instruments are put up: centre (3,) of the workspace, sizes, SI."""

    centre: Array
    size: float
    sigma: float
    rng: np.random.Generator

    def unknowns(self, *tolerances: float) -> Array:
        """Errors within tolerances."""
        return parameter_errors(np.array(tolerances), self.rng)


def _lengths(bench: Bench, names: Sequence[str]) -> dict[str, float]:
    return {f"{name}_um": 1e6 * bench.sigma for name in names}


def ball_bar(bench: Bench, name: str, length: float, cup: Array) -> Mounted:
    """A ball bar whose cup was set by hand near a stated place (3,)."""
    tolerance = min(1e-3, 2e-3 * bench.size)
    table = {"name": name, "instrument": "ball_bar_free_cup", "length_mm": 1e3 * length}
    table |= {f"at_{k}_mm": 1e3 * float(v) for k, v in zip(XYZ, cup, strict=True)}
    table["tolerance"] = {f"cup_{k}_mm": 1e3 * tolerance for k in XYZ}
    true_cup = cup + bench.unknowns(*[tolerance] * 3)

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        distance = np.linalg.norm(point - true_cup, axis=1)
        return 1e3 * (distance[:, None] + bench.sigma * errors)

    return Mounted(table, _lengths(bench, ["length"]), ("length_mm",), 1, read)


def position(bench: Bench, name: str, kind: str) -> Mounted:
    """A camera or tracker that reads positions in a frame of its own."""
    shift = {"camera": 5e-3, "pose_tracker_position": 0.05e-3}.get(kind, 5e-3)
    shift, turn = min(shift, 5e-3 * bench.size), 1e-3
    axes = (0, 1) if kind == "planar_position" else (0, 1, 2)
    turns = (
        ("turn_z",) if kind == "planar_position" else tuple(f"turn_{k}" for k in XYZ)
    )
    table: dict[str, Any] = {"name": name, "instrument": kind}
    table["tolerance"] = {f"shift_{XYZ[k]}_mm": 1e3 * shift for k in axes}
    table["tolerance"] |= {n: 1e3 * turn for n in (f"{t}_mrad" for t in turns)}
    offset = np.zeros(3)
    offset[list(axes)] = bench.unknowns(*[shift] * len(axes))
    angles = np.zeros(3)
    angles[3 - len(turns) :] = bench.unknowns(*[turn] * len(turns))
    frame = rotations(angles[None])[0]
    names = [f"read_{XYZ[k]}" for k in axes]

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        seen = (point @ frame.T + offset)[:, list(axes)]
        return 1e3 * (seen + bench.sigma * errors)

    columns = [f"{n}_mm" for n in names]
    return Mounted(table, _lengths(bench, names), columns, len(axes), read)


def pose_tracker(bench: Bench, name: str) -> Mounted:
    """A tracker of position and orientation."""
    shift, turn = 0.05e-3, 0.05e-3
    table: dict[str, Any] = {"name": name, "instrument": "pose_tracker"}
    table["tolerance"] = {f"shift_{k}_mm": 1e3 * shift for k in XYZ}
    table["tolerance"] |= {f"turn_{k}_mrad": 1e3 * turn for k in XYZ}
    offset = bench.unknowns(*[shift] * 3)
    frame = rotations(bench.unknowns(*[turn] * 3)[None])[0]
    angle_sigma = bench.sigma / bench.size
    angles = ("alpha", "beta", "gamma")
    noise = _lengths(bench, [f"read_{k}" for k in XYZ])
    noise |= {f"read_{a}_urad": 1e6 * angle_sigma for a in angles}

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        seen = point @ frame.T + offset + bench.sigma * errors[:, :3]
        turned = frame @ rotation
        flat = np.hypot(turned[:, 1, 2], turned[:, 2, 2])
        alpha = np.arctan2(-turned[:, 1, 2], turned[:, 2, 2])
        beta = np.arctan2(turned[:, 0, 2], flat)
        gamma = np.arctan2(-turned[:, 0, 1], turned[:, 0, 0])
        three = np.column_stack([alpha, beta, gamma]) + angle_sigma * errors[:, 3:]
        return np.hstack([1e3 * seen, np.rad2deg(three)])

    columns = [f"read_{k}_mm" for k in XYZ] + [f"read_{a}_deg" for a in angles]
    return Mounted(table, noise, columns, 6, read)


def laser_ball_bar(bench: Bench, name: str) -> Mounted:
    """A laser ball bar on a gimbal beside the workspace: range and two angles."""
    away = bench.centre + bench.size * np.array([0.6, -1.1, -0.5])
    shift, turn = 0.1e-3, 0.1e-3
    angle_sigma = bench.sigma / bench.size
    table: dict[str, Any] = {"name": name, "instrument": "laser_ball_bar_position"}
    table |= {f"at_{k}_mm": 1e3 * float(v) for k, v in zip(XYZ, away, strict=True)}
    table["range_noise_um"] = 1e6 * bench.sigma
    table["angle_noise_urad"] = 1e6 * angle_sigma
    table["tolerance"] = {f"shift_{k}_mm": 1e3 * shift for k in XYZ}
    table["tolerance"] |= {f"turn_{k}_mrad": 1e3 * turn for k in XYZ}
    offset = bench.unknowns(*[shift] * 3)
    frame = rotations(bench.unknowns(*[turn] * 3)[None])[0]

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        d = (point - away) @ frame.T + offset
        reach = np.linalg.norm(d, axis=1) + bench.sigma * errors[:, 0]
        up = np.arcsin(d[:, 2] / np.linalg.norm(d, axis=1)) + angle_sigma * errors[:, 1]
        # the error about z is one of the way round, which is shorter higher up
        around = np.arctan2(d[:, 1], d[:, 0]) + angle_sigma * errors[:, 2]
        flat = reach * np.cos(up)
        seen = [flat * np.cos(around), flat * np.sin(around), reach * np.sin(up)]
        return 1e3 * (np.column_stack(seen) + away)

    columns = [f"read_{k}_mm" for k in XYZ]
    return Mounted(table, {}, columns, 3, read)


def height(bench: Bench, name: str) -> Mounted:
    """A length gauge against a table that is nearly level."""
    offset_sd, tilt_sd = min(1e-3, 2e-3 * bench.size), 0.1e-3
    table = {"name": name, "instrument": "length_gauge", "at_z_mm": 0.0}
    table["tolerance"] = {
        "height_mm": 1e3 * offset_sd,
        "tilt_x_mrad": 1e3 * tilt_sd,
        "tilt_y_mrad": 1e3 * tilt_sd,
    }
    offset, tilt_x, tilt_y = bench.unknowns(offset_sd, tilt_sd, tilt_sd)

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        plane = offset + tilt_x * point[:, 1] - tilt_y * point[:, 0]
        return 1e3 * ((point[:, 2] - plane)[:, None] + bench.sigma * errors)

    return Mounted(table, _lengths(bench, ["height"]), ("height_mm",), 1, read)


def calliper(bench: Bench, name: str) -> Mounted:
    """A calliper: distances from a run's first pose on an object of unknown scale."""
    table: dict[str, Any] = {"name": name, "instrument": "calliper"}
    table["tolerance"] = {"scale_ppm": 100.0}
    scale = float(bench.unknowns(100e-6)[0])

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        distance = np.linalg.norm(point - point[:1], axis=1) * (1.0 + scale)
        return 1e3 * (distance[:, None] + bench.sigma * errors)

    noise = _lengths(bench, ["length"])
    return Mounted(table, noise, ("length_mm",), 1, read, reference=True)


def relative(bench: Bench, name: str, kind: str) -> Mounted:
    """Displacements from a line's first pose, of the planar machine (rm1 to rm5)."""
    axes = {"rm1": (1,), "rm2": (2,), "rm3": (2,), "rm4": (1,), "rm5": (1, 2)}[kind]
    table = {"name": name, "instrument": kind}
    names = [f"d{XYZ[k]}" for k in axes]

    def read(point: Array, rotation: Array, errors: Array) -> Array:
        moved = (point - point[:1])[:, list(axes)]
        return 1e3 * (moved + bench.sigma * (errors - errors[:1]))

    columns = [f"{n}_mm" for n in names]
    return Mounted(table, _lengths(bench, names), columns, len(axes), read, True)
