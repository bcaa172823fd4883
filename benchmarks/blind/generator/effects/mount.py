"""The measuring set-up and sudden changes: bar length, creeping mounts, steps."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator.effects.base import Effect, Stage, linear, spans
from benchmarks.blind.generator.instruments import STATE
from benchmarks.blind.generator.scene import Push


def bar_length(rng: Generator, stage: Stage) -> Effect:
    """The bar's calibration is off: every reading by the same length."""
    return linear("bar_length", Push(dy=stage.by_bar), (), {"length_um": 1e6})


def mount_drift(rng: Generator, stage: Stage) -> Effect:
    """A mount creeps after clamping: a fast and a slow part (log-like), and may slip
    once; set-ups differ.
    """
    plan = stage.plan
    ds = np.zeros((stage.rows, STATE))
    only = (
        int(rng.integers(len(plan.setups)))
        if len(plan.setups) > 1 and rng.random() < 0.4
        else None
    )
    for k, setup in enumerate(plan.setups):
        if only is not None and k != only:
            continue
        here = np.flatnonzero(plan.setup == k)
        t = plan.time[here] - plan.time[here[0]]
        creep = np.log1p(t / rng.uniform(300.0, 3000.0)) + rng.uniform(
            0.0, 0.6
        ) * t / max(float(t.max()), 1.0)
        slip = (
            rng.uniform(0.0, 0.3) * creep.max() * (t > rng.uniform(0.2, 0.9) * t.max())
        )
        way = rng.normal(size=len(setup.instrument.drifts))
        ds[np.ix_(here, np.array(setup.instrument.drifts))] = (
            (creep + slip)[:, None] * way / np.linalg.norm(way)
        )
    runs = (
        []
        if only is None
        else sorted({int(r) for r in plan.run[(plan.setup == only) & (plan.run >= 0)]})
    )
    blocks = tuple(f"run {plan.run_name(r)}" for r in runs)
    return linear("mount_drift", Push(ds=ds), blocks)


def step(rng: Generator, stage: Stage) -> Effect:
    """Something jumps at a moment: a leg's zero, a joint's place, or the reading; part
    of it may come back later.

    Its block is the time in which more than half of it acts: to the end where less than
    half comes back.
    """
    plan = stage.plan
    last = spans(plan)
    inside = int(rng.uniform(0.15, 0.85) * stage.rows)
    run = max(int(plan.run[inside]), 0)
    at = (
        float(plan.time[inside if rng.random() < 0.3 else plan.runs[run][0]]) - 1.0
    )  # mostly between runs
    rows = 1.0 * (plan.time >= at)
    end = last
    if rng.random() < 0.4:
        back, gone = at + rng.uniform(0.1, 0.6) * (last - at), rng.uniform(0.3, 1.0)
        rows = rows - gone * (plan.time >= back)
        end = back if gone > 0.5 else last
    blocks: tuple[str, ...] = (f"time {at:.0f}-{end:.0f}",)
    if (
        rng.random() < 0.75 or stage.machine.name == "planar"
    ):  # its mounts are zeroed with every run
        leg = int(rng.integers(stage.machine.legs))
        dq = np.zeros_like(stage.motion.q)
        dq[:, leg] = rows
        return linear(
            "step", Push(dq=dq), (*blocks, f"leg {leg + 1}"), at_s=at, what="leg zero"
        )
    ds = np.zeros((stage.rows, STATE))
    for k, setup in enumerate(plan.setups):
        here = plan.setup == k
        way = rng.normal(size=len(setup.instrument.drifts))
        ds[np.ix_(here, np.array(setup.instrument.drifts))] = (
            rows[here, None] * way / np.linalg.norm(way)
        )
    return linear("step", Push(ds=ds), blocks, at_s=at, what="mount")
