"""Effects that are in nobody's library."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator.effects.base import (
    Effect,
    Stage,
    linear,
    place_joints,
    spans,
)
from benchmarks.blind.generator.effects.load import joint_force
from benchmarks.blind.generator.instruments import STATE
from benchmarks.blind.generator.scene import Push


def cross_talk(rng: Generator, stage: Stage) -> Effect:
    """The controller lets one leg's current disturb another: force of one times the
    rate's sign of the next.
    """
    legs = stage.machine.legs
    a, b = rng.choice(legs, 2, replace=False)
    other = stage.motion.rate[:, b] / np.abs(stage.motion.rate[:, b]).max()
    dq = np.zeros_like(stage.motion.q)
    dq[:, a] = other * (
        1.0 + stage.stroke[:, a] * rng.uniform(0.3, 1.0)
    ) + 0.4 * np.abs(other)
    return linear("cross_talk", Push(dq=dq), (f"leg {a + 1}",), source=f"leg {b + 1}")


def feed_resonance(rng: Generator, stage: Stage) -> Effect:
    """The structure rings at one feed only: a wave along the path, largest where the
    path bends most.
    """
    feeds = np.unique(stage.plan.feed[stage.plan.feed > 0])
    feed = feeds[-1] if rng.random() < 0.7 else feeds[0]
    wave = feed * rng.uniform(2.0, 7.0)  # m of path a cycle: aliased by the readings
    shape = np.sin(2 * np.pi * stage.motion.arc / (wave * 0.37) + rng.uniform(0, 6.28))
    swell = 1.0 + 0.6 * np.sin(2 * stage.plan.phase + rng.uniform(0, 6.28))
    way = rng.normal(size=3)
    if stage.machine.name == "planar":
        way[0] = 0.0
    on = np.isclose(stage.plan.feed, feed)
    field = (on * swell * (0.5 + shape))[:, None] * way / np.linalg.norm(way)
    runs = tuple(
        f"run {stage.plan.run_name(r)}"
        for r in sorted({int(v) for v in stage.plan.run[on]})
    )
    blocks = () if len(feeds) == 1 else runs
    return linear("feed_resonance", Push(dtip=field), blocks, feed_mm_min=feed * 6e4)


def spindle_growth(rng: Generator, stage: Stage) -> Effect:
    """The tool grows while the spindle runs, and nobody wrote down when."""
    t, last = stage.plan.time, spans(stage.plan)
    growth = np.zeros(stage.rows)
    tau = rng.uniform(400.0, 1500.0)
    blocks = []
    for _ in range(int(rng.integers(2, 5))):
        on = rng.uniform(0.0, 0.85) * last
        off = on + rng.uniform(0.05, 0.2) * last
        rise = 1.0 - np.exp(-np.clip(t - on, 0.0, off - on) / tau)
        growth += rise * np.exp(-np.clip(t - off, 0.0, None) / (1.5 * tau)) * (t >= on)
        blocks.append(f"time {on:.0f}-{off:.0f}")
    field = -growth[:, None] * stage.motion.axis
    return linear("spindle_growth", Push(dtip=field), tuple(blocks), tau_s=tau)


def humidity_wave(rng: Generator, stage: Stage) -> Effect:
    """A composite swells one way with the room's moisture, a slow wave of hours."""
    t = stage.plan.time
    wave = np.sin(
        2 * np.pi * t / (3600.0 * rng.uniform(1.5, 4.0)) + rng.uniform(0, 6.28)
    )
    wave += 0.4 * np.sin(
        2 * np.pi * t / (3600.0 * rng.uniform(0.7, 1.5)) + rng.uniform(0, 6.28)
    )
    total = stage.zero()
    for leg in range(stage.machine.legs):
        shift = np.ones((stage.rows, 1)) * rng.normal(size=3)
        total += place_joints(stage, leg, shift, platform=True)
    return linear("humidity_wave", Push(dp=total * wave[:, None]))


def cable_drag(rng: Generator, stage: Stage) -> Effect:
    """A cable pulls the tool aside, by where it points, and differently on the way
    back.
    """
    phase = stage.plan.phase
    lag = rng.uniform(0.3, 1.0) * stage.plan.direction
    pull = np.exp(1.5 * np.cos(phase - rng.uniform(0, 6.28) - lag)) - 1.2
    away = stage.motion.tip - stage.motion.tip.mean(0)
    side = np.stack([away[:, 1], -away[:, 0], 0 * away[:, 0]], -1)
    if stage.machine.name == "planar":
        side = np.stack([0 * pull, pull, 0.5 * pull**2], -1)
    size = np.abs(side).max()
    field = pull[:, None] * (side / size + 0.4 * rng.normal(size=3))
    if stage.machine.name == "planar":
        field[:, 0] = 0.0
    return linear("cable_drag", Push(dtip=field))


def platform_torsion(rng: Generator, stage: Stage) -> Effect:
    """The platform twists with the moment of its load: joints move sideways by one
    leg's force times another's.
    """
    force = joint_force(stage, 0.4 * stage.machine.weight)
    force = force / np.abs(force).max()
    moment = force[:, 0] * force[:, 1] - 0.6 * force[:, 0] ** 2
    total = stage.zero()
    for leg in range(stage.machine.legs):
        v = np.cross(stage.motion.leg[:, leg], rng.normal(size=3)) * moment[:, None]
        total += place_joints(stage, leg, v, platform=True)
    return linear("platform_torsion", Push(dp=total))


def interference(rng: Generator, stage: Stage) -> Effect:
    """Something electrical at a fixed period in time beats with the readings."""
    period = float(rng.choice([17.0, 41.0, 90.0, 300.0, 700.0])) * rng.uniform(0.9, 1.1)
    t = stage.plan.time[stage.layout.row]
    wave = np.sin(2 * np.pi * t / period + rng.uniform(0, 6.28))
    wave = wave + 0.5 * np.sign(np.sin(4 * np.pi * t / period))
    channel = stage.layout.channel == rng.integers(stage.layout.channel.max() + 1)
    return linear(
        "interference",
        Push(dy=wave * channel * stage.layout.sigma / stage.layout.sigma.max()),
        period_s=period,
    )


def table_sag(rng: Generator, stage: Stage) -> Effect:
    """The table gives way under the tool's place, and the mount on it leans."""
    place = stage.motion.tip
    reach = max(float(np.ptp(place, axis=0).max()), 1e-9)
    centre = place[int(rng.integers(stage.rows))]
    dip = np.exp(
        -((place - centre) ** 2).sum(-1) / (rng.uniform(0.1, 0.22) * reach) ** 2
    )
    ds = np.zeros((stage.rows, STATE))
    for k, setup in enumerate(stage.plan.setups):
        here = stage.plan.setup == k
        way = rng.normal(size=len(setup.instrument.drifts))
        ds[np.ix_(here, setup.instrument.drifts)] = dip[here, None] * way
    return linear("table_sag", Push(ds=ds))


def wrong_table(rng: Generator, stage: Stage) -> Effect:
    """One corner of the controller's compensation table is wrong: two legs, a patch of
    the workspace.
    """
    legs = stage.machine.legs
    a, b = rng.choice(legs, 2, replace=False)
    centre = stage.stroke[int(rng.integers(stage.rows))]
    near = np.exp(
        -(np.abs(stage.stroke[:, [a, b]] - centre[[a, b]]) ** 4)
        / rng.uniform(0.2, 0.3) ** 4
    )
    dq = np.zeros_like(stage.motion.q)
    dq[:, a], dq[:, b] = near.prod(1), rng.uniform(-1.0, 1.0) * near.prod(1)
    return linear("wrong_table", Push(dq=dq), (f"leg {a + 1}", f"leg {b + 1}"))


def pump(rng: Generator, stage: Stage) -> Effect:
    """A coolant pump switches on and off and moves everything a little while it runs."""
    t, last = stage.plan.time, spans(stage.plan)
    cycle, share = rng.uniform(0.06, 0.15) * last, rng.uniform(0.3, 0.7)
    on = ((t / cycle + rng.random()) % 1.0) < share
    dq = on[:, None] * rng.normal(size=stage.machine.legs) * (1.0 + 0.5 * stage.stroke)
    return linear("pump", Push(dq=dq), cycle_s=cycle)


def run_in(rng: Generator, stage: Stage) -> Effect:
    """Each run begins unsettled: oil film and servo take some readings to come to rest."""
    fade = np.zeros(stage.rows)
    lengths = rng.uniform(1.5, 4.5)
    for here in stage.plan.runs:
        fade[here] = np.exp(-np.arange(len(here)) / lengths) * rng.uniform(0.6, 1.4)
    way = rng.normal(size=3)
    if stage.machine.name == "planar":
        way[0] = 0.0
    return linear(
        "run_in", Push(dtip=fade[:, None] * way / np.linalg.norm(way)), readings=lengths
    )


def stick(rng: Generator, stage: Stage) -> Effect:
    """A cover rubs in one sector, one way only."""
    way = 1.0 if rng.random() < 0.5 else -1.0
    phase = stage.plan.phase
    centre = rng.choice(phase[stage.plan.run >= 0])
    wide = 0.5 if np.ptp(phase) > 3.0 else 0.2
    gap = (
        np.angle(np.exp(1j * (phase - centre)))
        if np.ptp(phase) > 3.0
        else phase - centre
    )
    patch = np.exp(-((gap / wide) ** 2)) * (stage.plan.direction == way)
    dq = patch[:, None] * rng.normal(size=stage.machine.legs)
    blocks: tuple[str, ...] = (f"direction {way:+.0f}",)
    if np.ptp(phase) > 3.0:
        low, high = (
            np.rad2deg(centre - 1.2 * wide) % 360,
            np.rad2deg(centre + 1.2 * wide) % 360,
        )
        blocks = (*blocks, f"phase {low:.0f}-{high:.0f}")
    return linear("stick", Push(dq=dq), blocks)
