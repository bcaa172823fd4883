"""Readings files of a hexapod, a linear delta and a 3-PRS head, by their oracles."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pandas as pd
from blunder_tables import ARCSEC, DEG, MM, UM, Array, noise, table
from oracles import delta_trilateration as trilateration
from oracles import hexapod_geometry as gough
from oracles import prs_geometry as prs

from oed.measurement.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import calliper, height_probe, laser_ball_bar, pose_tracker
from pkm_models.machines import hexapod, linear_delta, prs_spindle

# -- hexapod, tracker, recorded joints -------------------------------------------------

TRACKER_NOISE = np.array([10 * UM] * 3 + [5 * ARCSEC] * 3)


@functools.cache
def hexapod_measurement() -> Measurement:
    return Measurement(hexapod.machine, [mount(pose_tracker.instrument, "tracker")])


def axis_order_angles(rotation: Array) -> Array:
    """alpha, beta, gamma (..., 3) with R = Rx(alpha) Ry(beta) Rz(gamma)."""
    return np.asarray(prs.angles(rotation))


def hexapod_readings(rng: np.random.Generator, law: str) -> pd.DataFrame:
    """Poses in four runs through the workspace, by recorded leg lengths."""
    base = np.array([hexapod.B[i] for i in hexapod.LEGS])
    local = np.array([hexapod.A[i] for i in hexapod.LEGS])
    errors = [0.3e-3 * rng.standard_normal((6, 3)) for _ in range(2)]
    zeros = 0.5e-3 * rng.standard_normal(6)
    shift, turn = 5e-5 * rng.standard_normal((2, 3))
    frame = prs.rotation(*turn)
    count, legs, read = 8, [], []
    for _ in range(4 * count):
        point = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.09, 0.09, 3)
        rotation = prs.rotation(*rng.uniform(-0.2, 0.2, 3))
        length = gough.legs(point, rotation, base, local)
        start = point + local @ rotation.T
        at, turned = gough.forward(
            length + zeros, base + errors[0], local + errors[1], start
        )
        legs.append(length)
        read.append([*(frame @ at + shift), *axis_order_angles(frame @ turned)])
    run = [f"set {1 + k // count}" for k in range(4 * count)]
    error = np.column_stack([noise(rng, law, np.array(run)) for _ in range(6)])
    y = np.array(read) + TRACKER_NOISE * error
    columns = {f"q{i + 1}_mm": np.array(legs)[:, i] / MM for i in range(6)}
    columns |= {f"read_{n}_mm": y[:, k] / MM for k, n in enumerate("xyz")}
    angles = ("alpha", "beta", "gamma")
    columns |= {f"read_{n}_deg": y[:, 3 + k] / DEG for k, n in enumerate(angles)}
    return table("tracker", run, columns)


# -- linear delta, heights and distances -----------------------------------------------

DELTA_NOISE = {"probe": 10 * UM, "calliper": 20 * UM}


@functools.cache
def delta_measurement() -> Measurement:
    setups = [
        mount(height_probe.instrument, "probe", sigma=[DELTA_NOISE["probe"]]),
        mount(calliper.instrument, "calliper", sigma=[DELTA_NOISE["calliper"]]),
    ]
    return Measurement(linear_delta.machine, setups)


def delta_numbers(rng: np.random.Generator | None) -> tuple[float, Array, Array, Array]:
    """Radius, arms, angles and endstops of the drawing, or of a drawn machine; m, rad."""
    middle = [linear_delta.RADIUS, *[linear_delta.ARM] * 3]
    middle += [*linear_delta.ANGLE.values(), *[linear_delta.ENDSTOP] * 3]
    numbers = np.array(middle)
    if rng is not None:
        sd = np.array([0.5e-3, *[1e-3] * 3, 3.5e-3, 3.5e-3, 0.0, *[1.5e-3] * 3])
        numbers = numbers + sd * rng.standard_normal(10)
    return numbers[0], numbers[1:4], numbers[4:7], numbers[7:]


def delta_points(rng: np.random.Generator) -> tuple[Array, list[str]]:
    """Commands (n, 3), m, of heights on three levels."""
    around = np.arange(14) * 2.4
    radius = 0.12 * np.sqrt((np.arange(14) + 0.5) / 14)
    flat = np.column_stack([radius * np.cos(around), radius * np.sin(around)])
    levels = (0.005, 0.120, 0.250)
    points = [np.column_stack([flat, np.full(14, z)]) for z in levels]
    return np.vstack(points), [f"level {1 + k // 14}" for k in range(42)]


def delta_readings(rng: np.random.Generator, law: str) -> pd.DataFrame:
    drawn, true = delta_numbers(None), delta_numbers(rng)

    def place(command: Array) -> Array:
        return trilateration.nozzle(trilateration.travel_to(command, *drawn), *true)

    points, run = delta_points(rng)
    height = place(points)[:, 2] + 50 * UM * rng.standard_normal()
    height = height + DELTA_NOISE["probe"] * noise(rng, law, np.array(run))
    columns = {f"{n}_mm": points[:, k] / MM for k, n in enumerate("xyz")}
    parts = [table("probe", run, {**columns, "height_mm": height / MM})]
    corner = np.deg2rad(60.0 * np.arange(6))
    ring = np.column_stack([0.1 * np.cos(corner), 0.1 * np.sin(corner)])
    both = [np.vstack([ring[k : k + 1], np.delete(ring, k, axis=0)]) for k in (0, 2)]
    pairs = np.column_stack([np.vstack(both), np.full(12, 0.02)])
    run = [f"part {1 + k // 6}" for k in range(12)]
    at = place(pairs)
    first = 6 * (np.arange(12) // 6)
    distance = np.linalg.norm(at - at[first], axis=1)
    distance *= 1.0 + 1e-3 * rng.standard_normal()
    distance += DELTA_NOISE["calliper"] * noise(rng, law, np.array(run))
    distance[[0, 6]] = np.nan
    columns = {f"{n}_mm": pairs[:, k] / MM for k, n in enumerate("xyz")}
    parts.append(table("calliper", run, {**columns, "length_mm": distance / MM}))
    return pd.concat(parts, ignore_index=True)


# -- 3-PRS spindle head, laser ball bar ------------------------------------------------

GIMBAL = np.array([0.0, -0.7, 0.1])


@functools.cache
def prs_measurement() -> Measurement:
    at = {f"at_{n}": float(GIMBAL[k]) for k, n in enumerate("xyz")}
    return Measurement(
        prs_spindle.machine, [mount(laser_ball_bar.instrument, "bar", **at)]
    )


def prs_readings(rng: np.random.Generator, law: str) -> pd.DataFrame:
    """Three heights of eleven tilts each."""
    sd = 1e-3 * np.array([0.2, 0.2, 0.2, 1.0, 1.0, 0.5])
    p = sd * rng.standard_normal((3, 6))
    tilts = np.deg2rad(prs.TABLE_2[:11])
    command = np.vstack(
        [np.column_stack([np.full(11, z), tilts]) for z in (0.1, 0.2, 0.3)]
    )
    run = [f"height {1 + k // 11}" for k in range(33)]
    _, _, q = prs.nominal(*command.T)
    shift, turn = 1e-4 * rng.standard_normal((2, 3))
    unit = np.array([0.3 * UM, 1.15 * ARCSEC, 1.15 * ARCSEC])
    drawn = [noise(rng, law, np.array(run)) for _ in range(6)]
    error = unit * np.stack(drawn, -1).reshape(33, 2, 3)
    y = prs_poses(q, p, shift, turn, error)
    columns = {
        "z_mm": command[:, 0] / MM,
        "alpha_deg": command[:, 1] / DEG,
        "beta_deg": command[:, 2] / DEG,
    }
    columns |= {f"read_{n}_mm": y[:, k] / MM for k, n in enumerate("xyz")}
    columns |= {
        f"read_{n}_deg": y[:, 3 + k] / DEG for k, n in enumerate(("alpha", "beta"))
    }
    rows = table("bar", run, columns)
    rows.attrs = {"machine": (q, p, shift, turn, error)}
    return rows


def prs_poses(q: Array, p: Array, shift: Array, turn: Array, error: Array) -> Array:
    """x, y, z, alpha, beta (n, 5) at slider heights q (n, 3), m and rad."""
    true = prs.forward(q, p)
    frame = prs.rotation(*turn)
    tip = (true.tip - GIMBAL) @ frame.T + GIMBAL + shift
    y = prs.laser_ball_bar(tip, frame @ true.rotation, GIMBAL, 0.1, error)
    return np.asarray(y)


def dead_length(amount: float, run: str = "") -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Rows whose ranges are longer by an amount, mm, in the file or in one run."""

    def make(rows: pd.DataFrame) -> pd.DataFrame:
        *others, error = rows.attrs["machine"]
        at = (rows["run"] == run).to_numpy() | (not run)
        longer = error.copy()
        longer[at, :, 0] += amount * MM
        return _with_prs_readings(rows, prs_poses(*others, longer))

    return make


def redriven_prs(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of a head whose sliders have the heights of those before them."""
    q, *others = rows.attrs["machine"]
    return _with_prs_readings(rows, prs_poses(np.roll(q, 1, axis=1), *others))


def _with_prs_readings(rows: pd.DataFrame, y: Array) -> pd.DataFrame:
    changed = rows.copy()
    for k, name in enumerate(("x_mm", "y_mm", "z_mm", "alpha_deg", "beta_deg")):
        unit = MM if k < 3 else DEG
        changed[f"read_{name}"] = np.round(y[:, k] / unit, 5)
    return changed
