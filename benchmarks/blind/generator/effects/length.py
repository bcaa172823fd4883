"""Scales, screws and joints: errors that repeat with a leg's length or a joint's angle."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator.effects.base import (
    Effect,
    Stage,
    linear,
    pick_legs,
    place_joints,
    smooth,
)
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.scene import Push


def encoder_scale(rng: Generator, stage: Stage) -> Effect:
    """A scale that is not quite uniform: what is uniform of it hides in the geometry,
    more than what is not.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.6)
    u = stage.stroke
    bend = rng.uniform(-0.04, 0.04) * float(np.ptp(stage.motion.q)) / 2
    dq = gains * (stage.motion.q + bend * (u**2 + 0.4 * u**3))
    return linear(
        "encoder_scale", Push(dq=dq), blocks, {"scale_ppm": 1e6 * float(gains.max())}
    )


def common_scale(rng: Generator, stage: Stage) -> Effect:
    """The same scale error in every leg: on one bar and tool nothing tells it from the
    bar's length.
    """
    return linear(
        "encoder_scale",
        Push(dq=stage.motion.q.copy()),
        (),
        {"scale_ppm": 1e6},
        common=True,
    )


def pitch_accumulation(rng: Generator, stage: Stage) -> Effect:
    """Lead error of a screw: accumulated random pitch errors, smooth, with one worn
    stretch.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.6)
    u = stage.stroke
    dq = np.zeros_like(u)
    for leg in range(u.shape[1]):
        curve = smooth(rng, u[:, leg], int(rng.integers(5, 9)))
        worn = rng.uniform(0.0, 1.2) * np.exp(
            -(((u[:, leg] - rng.uniform(-0.6, 0.6)) / 0.25) ** 2)
        )
        dq[:, leg] = gains[leg] * (curve + worn)
    return linear("pitch_accumulation", Push(dq=dq), blocks)


def _harmonics(
    rng: Generator, phase: Array, orders: tuple[int, ...], first: float
) -> Array:
    wave = first * np.sin(phase + rng.uniform(0, 2 * np.pi))
    for order in orders:
        wave = wave + rng.uniform(0.1, 0.5) * np.sin(
            order * phase + rng.uniform(0, 2 * np.pi)
        )
    return np.asarray(wave)


def screw_cyclic(rng: Generator, stage: Stage) -> Effect:
    """Once and more per turn of the screw; the amplitude changes along it."""
    pitches = (
        (5.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0)
        if stage.machine.name != "planar"
        else (20.0, 25.0, 32.0, 40.0, 50.0)
    )
    pitch = float(rng.choice(pitches)) * 1e-3
    gains, blocks = pick_legs(rng, stage.machine.legs)
    u = stage.stroke
    dq = np.zeros_like(u)
    for leg in range(u.shape[1]):
        wave = _harmonics(
            rng,
            2 * np.pi * stage.motion.q[:, leg] / pitch,
            (2, 3) if rng.random() < 0.5 else (2,),
            1.0,
        )
        dq[:, leg] = gains[leg] * wave * (1.0 + rng.uniform(-0.3, 0.3) * u[:, leg])
    return linear("screw_cyclic", Push(dq=dq), blocks, pitch_mm=1e3 * pitch)


def encoder_subdivision(rng: Generator, stage: Stage) -> Effect:
    """Interpolation error within a grating's period: offset and amplitude of sine and
    cosine, so first and second.
    """
    fine = {"planar": (40, 100, 200), "delta": (1000, 2000, 5000)}
    period = float(rng.choice(fine.get(stage.machine.name, (20, 40, 100)))) * 1e-6
    gains, blocks = pick_legs(rng, stage.machine.legs)
    dq = np.zeros_like(stage.motion.q)
    for leg in range(dq.shape[1]):
        dq[:, leg] = gains[leg] * _harmonics(
            rng, 2 * np.pi * stage.motion.q[:, leg] / period, (2, 4), 1.0
        )
    return linear("encoder_subdivision", Push(dq=dq), blocks, period_um=1e6 * period)


def joint_runout(rng: Generator, stage: Stage) -> Effect:
    """A joint's centre wanders as it swings: harmonics of the leg's direction angle,
    base or platform side.
    """
    legs = stage.machine.legs
    chosen = [int(rng.integers(legs))] if rng.random() < 0.6 else list(range(legs))
    platform = bool(rng.random() < 0.5)
    total = stage.zero()
    for leg in chosen:
        v = stage.motion.leg[:, leg]
        direction = np.einsum("nij,ni->nj", stage.motion.pose.R0, v) if platform else v
        swing = np.arctan2(
            direction @ _across(rng, direction),
            np.abs(direction @ (direction.mean(0) / np.linalg.norm(direction.mean(0)))),
        )
        shift = np.zeros((stage.rows, 3))
        for axis in range(
            3
        ):  # eccentricity, ovality, and the waviness of rolling elements
            for orders, size in (((1, 2), 1.0), ((2, 3), 0.7), ((8, 12, 16), 0.15)):
                wave = np.cos(swing * rng.choice(orders) + rng.uniform(0, 2 * np.pi))
                shift[:, axis] += size * rng.normal() * wave
        total += place_joints(stage, leg, shift, platform=platform)
    blocks = (f"leg {chosen[0] + 1}",) if len(chosen) == 1 else ()
    return linear(
        "joint_runout", Push(dp=total), blocks, side="platform" if platform else "base"
    )


def _across(rng: Generator, v: Array) -> Array:
    """The direction (3,) in which the unit vectors v (n, 3) swing most."""
    return np.asarray(np.linalg.svd(v - v.mean(0), full_matrices=False)[2][0])
