"""Effects of moving: backlash, friction, following error, joint clearance. All
remember, saturate or spread.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from benchmarks.blind.generator.effects.base import Effect, Stage, linear, pick_legs
from benchmarks.blind.generator.effects.load import joint_force
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.runs import Index
from benchmarks.blind.generator.scene import Push


@dataclasses.dataclass(frozen=True)
class Pass:
    """The way through one run: q (m, legs) with each leg's turning points between; row
    (m,) that each is for, or -1.

    Closed circles are entered rolling, half a turn before.
    """

    q: Array
    row: Index


def passes(stage: Stage) -> list[Pass]:
    """The way through every run, in order."""
    ways = []
    for here, closed in zip(stage.plan.runs, stage.plan.closed, strict=True):
        q = stage.motion.q[here]
        if closed:
            ring = np.vstack([q, q[:1]])
            slope = CubicSpline(np.arange(len(ring)), ring, bc_type="periodic")(
                np.arange(len(here)), 1
            )
            start = len(here) // 2
            order = np.r_[np.arange(start, len(here)), np.arange(len(here))]
            row = np.r_[np.full(len(here) - start, -1), here]
        else:
            slope = CubicSpline(np.arange(len(here)), q)(np.arange(len(here)), 1)
            order, row = np.arange(len(here)), here
        q, slope = q[order], slope[order]
        turns = _turning(q[:-1], q[1:], slope[:-1], slope[1:])
        way = np.empty((2 * len(q) - 1, q.shape[1]))
        way[::2], way[1::2] = q, turns
        rows = np.full(len(way), -1)
        rows[::2] = row
        ways.append(Pass(way, rows))
    return ways


def _turning(q0: Array, q1: Array, m0: Array, m1: Array) -> Array:
    """Extremum of the cubic between neighbours where their slopes differ in sign, else
    the middle; (m, legs).
    """
    a, b = 2 * (q0 - q1) + m0 + m1, 3 * (q1 - q0) - 2 * m0 - m1
    # root of 3 a t^2 + 2 b t + m0 in 0..1, in the form that is safe for small a
    root = np.sqrt(np.maximum(b**2 - 3 * a * m0, 0.0))
    t = np.divide(
        -m0,
        b + np.where(m1 >= m0, root, -root),
        out=np.full_like(q0, 0.5),
        where=m0 * m1 < 0,
    )
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(((a * t + b) * t + m0) * t + q0)


def play(stage: Stage, ways: Sequence[Pass], widths: Array, weights: Array) -> Array:
    """Weighted sum (n, legs) of play operators less their input; `widths` (k, legs), m,
    `weights` (k,).

    The state is carried from run to run; it is what each machine part remembers.
    """
    out = np.zeros_like(stage.motion.q)
    half = widths / 2
    state = np.repeat(stage.motion.q[:1], len(widths), axis=0)
    for way in ways:
        low, high = way.q[:, None] - half, way.q[:, None] + half
        for k, row in enumerate(way.row):
            state = np.minimum(np.maximum(state, low[k]), high[k])
            if row >= 0:
                out[row] = weights @ (state - way.q[k])
    return out


def backlash(rng: Generator, stage: Stage) -> Effect:
    """Play with memory: several gaps in a row, softened; amplitude is half the total
    gap of the loosest leg.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs)
    ratio = np.sort(rng.uniform(0.3, 1.0, 3))
    weights = rng.dirichlet(np.ones(3))
    ratio[-1] = 1.0
    scale = 1.0 / float((weights * ratio).sum())
    ways = passes(stage)
    wear = 1.0 + rng.uniform(0.0, 0.35) * stage.stroke * rng.choice([-1.0, 1.0])

    def push(a: float) -> Push:
        widths = 2 * a * scale * ratio[:, None] * gains / gains.max()
        return Push(dq=play(stage, ways, widths, weights) * wear)

    return Effect(
        name="backlash",
        push=push,
        blocks=blocks,
        about={"gaps": ratio.round(3).tolist()},
        unit={"gap_um": 2e6},
    )


def friction(rng: Generator, stage: Stage) -> Effect:
    """Wind-up against a compliant drive: Dahl's presliding, Stribeck over speed, drag
    that varies along the stroke.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs)
    q, rate = stage.motion.q, stage.motion.rate
    slide = float(
        np.exp(rng.uniform(np.log(0.03e-3), np.log(0.6e-3)))
    )  # m, presliding of drives
    swing = rng.uniform(0.05, 0.2) * np.sin(
        rng.uniform(1.5, 4.0) * stage.stroke + rng.uniform(0, 2 * np.pi)
    )
    slow = np.median(np.abs(rate)) * rng.uniform(0.2, 0.8)
    level = (1.0 + swing) * (
        1.0 + rng.uniform(0.05, 0.3) * np.exp(-np.abs(rate) / slow)
    )
    yielding = 1.0 + rng.uniform(0.5, 1.5) * (q - q.mean(0)) / q.mean(0)
    dq = -gains * level * yielding * _dahl(stage, slide)
    return linear(
        "friction", Push(dq=dq), blocks, {"wind_up_um": 1e6}, presliding_mm=1e3 * slide
    )


def _dahl(stage: Stage, slide: float) -> Array:
    """Wound-up share (n, legs), -1..1: it follows the direction of travel after a way
    of `slide`, m.
    """
    out, state = np.zeros_like(stage.motion.q), np.zeros(stage.machine.legs)
    for way in passes(stage):
        steps = np.diff(way.q, axis=0, prepend=way.q[:1])
        sign, keep = np.sign(steps), np.exp(-np.abs(steps) / slide)
        if way.row[0] >= 0:  # a line is entered rolling
            state = sign[1]
        for k, row in enumerate(way.row):
            state = sign[k] + (state - sign[k]) * keep[k]
            if row >= 0:
                out[row] = state
    return out


def servo_lag(rng: Generator, stage: Stage) -> Effect:
    """Following error of a loop with feed-forward: rate and acceleration parts,
    saturating, gains unequal.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.4)
    rate, acc = stage.motion.rate, stage.motion.acceleration
    top = float(np.abs(rate).max())
    curve = rng.uniform(0.0, 0.35)
    lag = rate * (1.0 - curve * np.abs(rate) / top)
    second = (
        rng.uniform(-0.4, 0.4)
        * acc
        * (np.abs(lag).max() / max(float(np.abs(acc).max()), 1e-12))
    )
    return linear(
        "servo_lag",
        Push(dq=-gains * (lag + second)),
        blocks,
        {"delay_ms": 1e3 * float(gains.max())},
        curve=curve,
    )


def joint_clearance(rng: Generator, stage: Stage) -> Effect:
    """Joints settle on one side of their gap or the other by the sign of its force,
    softly, and a little aside.
    """
    gains, blocks = pick_legs(rng, stage.machine.legs)
    force = joint_force(stage, rng.uniform(0.0, 0.6) * stage.machine.weight)
    soft = np.tanh(force / (rng.uniform(0.02, 0.15) * np.abs(force).max(0)))
    aside = rng.uniform(0.0, 0.2) * stage.stroke * np.abs(soft)
    return linear("joint_clearance", Push(dq=-gains * (soft + aside)), blocks)
