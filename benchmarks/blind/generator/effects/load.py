"""Weight and payload: compliance of legs and joints, bending of the frame."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator.effects.base import Effect, Stage, linear, smooth
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.scene import Push


def joint_force(stage: Stage, weight: float) -> Array:
    """Force (n, legs), N, that each joint carries: payload at the tool point and the
    moving weight at its centre.
    """
    motion = stage.motion
    return np.asarray(
        stage.plan.payload[:, None] * motion.lift + weight * motion.lift_com
    )


def gravity(rng: Generator, stage: Stage) -> Effect:
    """Legs shorten under force: longer ones more (beam-like), stiffer under load, no
    two alike.
    """
    machine, q = stage.machine, stage.motion.q
    weight = machine.weight * rng.uniform(0.6, 1.4)
    force = joint_force(stage, weight)
    typical = float(np.abs(force).mean())
    harden = rng.uniform(0.0, 0.35)
    load = force * (np.abs(force) / typical + 0.05) ** -harden
    slender = 1.0 + rng.uniform(0.2, 1.2) * (
        (q / q.mean(0)) ** rng.choice([1.0, 2.0, 3.0]) - 1.0
    )
    legs = np.clip(1.0 + 0.15 * rng.normal(size=machine.legs), 0.6, 1.4)
    dq = -load * slender * legs
    units = {"compliance_um_per_kN": 1e9}
    return linear("gravity", Push(dq=dq), (), units, weight_N=weight, hardening=harden)


def frame_bending(rng: Generator, stage: Stage) -> Effect:
    """A smooth field of pose that no joint explains: a few bent modes of the tool's
    displacement.
    """
    command = stage.plan.command
    span = np.ptp(command, axis=0)
    varying = span > 1e-9
    u = 2 * (command[:, varying] - command[:, varying].min(0)) / span[varying] - 1
    place = stage.motion.tip
    reach = np.ptp(place, axis=0)
    v = 2 * (place - place.min(0)) / np.where(reach > 1e-9, reach, 1.0) - 1
    field = np.zeros((stage.rows, 3))
    for _ in range(int(rng.integers(2, 4))):
        mix = v @ rng.normal(size=3) / np.sqrt(3.0)
        mix = mix + 0.15 * rng.normal() * np.sin(np.pi * u[:, rng.integers(u.shape[1])])
        bow = np.tanh(mix) * np.cos(
            rng.uniform(0.5, 1.5) * mix + rng.uniform(0, 2 * np.pi)
        )
        mode = 0.4 * bow + mix**2
        field += mode[:, None] * rng.normal(size=3)
    sag = 1.0 + rng.uniform(0.0, 0.5) * stage.plan.payload / max(
        float(stage.plan.payload.max()), 1.0
    )
    if stage.machine.name == "planar":
        field[:, 0] = 0.0
    return linear("frame_bending", Push(dtip=field * sag[:, None]))


def guideway(rng: Generator, stage: Stage) -> Effect:
    """A carriage leaves its straight line: bows, a joint between two rails, a short
    wave.
    """
    machine = stage.machine
    legs = (
        [int(rng.integers(machine.legs))]
        if rng.random() < 0.6
        else list(range(machine.legs))
    )
    dp = stage.zero()
    for leg in legs:
        u = stage.stroke[:, leg]
        for name in ("side",) if machine.name == "planar" else ("out", "side"):
            bow = smooth(rng, u, int(rng.integers(4, 8)))
            kink = rng.uniform(0.0, 0.8) * np.tanh((u - rng.uniform(-0.6, 0.6)) / 0.05)
            dp[:, machine.column(f"{name}{leg + 1}")] = bow + kink
    blocks = (f"leg {legs[0] + 1}",) if len(legs) == 1 else ()
    return linear("guideway", Push(dp=dp), blocks)
