"""Heat: the climate of a case, and what it does to legs, frame and bar.

Bodies warm with two time constants each (motor and nut fast, castings slow), legs
unequally; sensors sit at one place and lag. The textbook forms have one gain and one
time constant, or take a sensor at its word.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator.effects.base import (
    Climate,
    Effect,
    Stage,
    linear,
    pick_legs,
)
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.plans import Plan
from benchmarks.blind.generator.scene import Push

GRID = 60.0  # s


def _lagged(drive: Array, tau: float) -> Array:
    """First-order answer (m,) to a drive (m,) on the time grid."""
    keep = np.exp(-GRID / tau)
    out = np.empty_like(drive)
    state = 0.0
    for k, u in enumerate(drive):
        state = keep * state + (1.0 - keep) * u
        out[k] = state
    return out


def climate(rng: Generator, plan: Plan) -> Climate:
    """Temperature rises at the rows' times."""
    last = float(plan.time.max()) + 2 * GRID
    t = np.arange(0.0, last, GRID)
    busy = np.full(len(t), 0.75)
    for begin, end in plan.pauses:
        busy[(t >= begin) & (t < end)] = 0.05
    for here in plan.runs:
        busy[(t >= plan.time[here[0]] - GRID) & (t <= plan.time[here[-1]])] += (
            0.5 * np.sqrt(plan.feed[here[0]] / plan.feed.max())
        )
    fast, slow = (
        _lagged(busy, rng.uniform(400.0, 1500.0)),
        _lagged(busy, rng.uniform(3600.0, 9000.0)),
    )
    share = rng.uniform(0.25, 0.75, plan.machine.legs)
    gain = np.clip(
        1.0 + 0.25 * rng.normal(size=plan.machine.legs), 0.4, 1.7
    ) * rng.uniform(4.0, 9.0)
    leg = gain * (share * fast[:, None] + (1 - share) * slow[:, None])
    room = rng.uniform(0.8, 2.0) * np.sin(
        2 * np.pi * t / 86400.0 * rng.uniform(0.8, 1.5) + rng.uniform(-0.8, 0.3)
    )
    room = room - room[0]
    frame = rng.uniform(1.0, 3.0) * _lagged(
        slow, rng.uniform(3600.0, 9000.0)
    ) + 0.6 * _lagged(room, 5400.0)
    hand = np.zeros(len(t))
    for k in range(len(plan.setups)):
        start = plan.time[plan.setup == k].min()
        hand += np.where(
            t >= start - GRID,
            np.exp(-(t - start + GRID) / rng.uniform(700.0, 2400.0)),
            0.0,
        )
    bar = rng.uniform(0.2, 0.6) * room + rng.uniform(1.5, 3.0) * hand
    at = [np.interp(plan.time, t, v) for v in (*leg.T, frame, bar)]
    legs = np.stack(at[: plan.machine.legs], -1)
    return Climate(
        legs, at[-2], at[-1], _sensors(rng, plan, t, leg.mean(1), frame, bar)
    )


def _sensors(
    rng: Generator, plan: Plan, t: Array, leg: Array, frame: Array, bar: Array
) -> dict[str, Array]:
    """Sensor readings (n,): lagged, with an offset, noise of 0.05 K, told to 0.1 K."""
    shown = {}
    for name, body in (
        ("temp_leg_C", leg),
        ("temp_frame_C", frame),
        ("temp_bar_C", bar),
    ):
        lagged = body[0] + _lagged(body - body[0], rng.uniform(120.0, 600.0))
        reading = rng.uniform(0.8, 1.1) * np.interp(plan.time, t, lagged) + rng.normal(
            0.0, 0.2
        )
        shown[name] = np.round(reading + rng.normal(0.0, 0.05, len(reading)), 1)
    return shown


def leg_thermal(rng: Generator, stage: Stage) -> Effect:
    """Screws grow along the part between nut and bearing; each leg has its own two time
    constants' mixture.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.4)
    q = stage.motion.q
    fixed = rng.uniform(0.0, 0.25) * q.min()
    dq = gains * (q - fixed) * stage.climate.leg
    top = float(stage.climate.leg.max())
    return linear(
        "leg_thermal",
        Push(dq=dq),
        blocks,
        {"expansion_ppm_per_K": 1e6},
        rise_K=round(top, 2),
        fixed_m=fixed,
    )


def frame_thermal(rng: Generator, stage: Stage) -> Effect:
    """The frame grows with a gradient: one side is nearer to the heat."""
    side = rng.normal(size=stage.machine.legs)
    spread = 1.0 + rng.uniform(0.1, 0.5) * side / np.abs(side).max()
    dp = stage.climate.frame[:, None] * stage.machine.growth(spread)
    top = float(np.ptp(stage.climate.frame))
    return linear(
        "frame_thermal",
        Push(dp=dp),
        (),
        {"expansion_ppm_per_K": 1e6},
        rise_K=round(top, 2),
        spread=spread.round(3).tolist(),
    )


def bar_thermal(rng: Generator, stage: Stage) -> Effect:
    """The bar is warm from the hand, and follows the room: its reading loses what it
    has grown.
    """
    dy = -0.3 * stage.climate.bar[stage.layout.row] * stage.by_bar
    return linear(
        "bar_thermal",
        Push(dy=dy),
        (),
        {"expansion_ppm_per_K": 1e6},
        rise_K=round(float(np.ptp(stage.climate.bar)), 2),
    )
