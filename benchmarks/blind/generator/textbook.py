"""Textbook forms of the known effects, to tell how far a drawn form departs from them,
and who its rivals are.

Each name has one or more alternatives (a time constant, a pitch, a leg), each a list of
pushes whose sizes are free. They are first-order columns; the generator's own forms
(`effects`) are built otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from benchmarks.blind.generator.effects.base import Stage, place_joints
from benchmarks.blind.generator.effects.load import joint_force
from benchmarks.blind.generator.instruments import STATE
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.scene import Push, Scene
from benchmarks.blind.generator.severity import Metric, distance

Block = list[Push]
TAUS = (600.0, 1800.0, 5400.0, 14400.0)


def _per_leg(stage: Stage, values: Array) -> Block:
    """One column a leg from values (n, legs)."""
    eye = np.eye(stage.machine.legs)
    return [Push(dq=values * eye[i]) for i in range(len(eye))]


def _rises(stage: Stage) -> Iterator[Array]:
    t = stage.plan.time - stage.plan.time[0]
    for tau in TAUS:
        yield 1.0 - np.exp(-t / tau)


def _leg_thermal(stage: Stage) -> Iterator[Block]:
    for rise in [*_rises(stage), stage.climate.shown["temp_leg_C"]]:
        yield _per_leg(stage, stage.motion.q * rise[:, None])


def _frame_thermal(stage: Stage) -> Iterator[Block]:
    growth = stage.machine.growth(np.ones(stage.machine.legs))
    for rise in [*_rises(stage), stage.climate.shown["temp_frame_C"]]:
        yield [Push(dp=rise[:, None] * growth)]


def _gravity(stage: Stage) -> Iterator[Block]:
    q, weight = stage.motion.q, joint_force(stage, 1.0) - joint_force(stage, 0.0)
    load = joint_force(stage, 0.0)
    yield [Push(dq=v) for v in (load, load * q, weight, weight * q)]


def _frame_bending(stage: Stage) -> Iterator[Block]:
    place = stage.motion.tip - stage.motion.tip.mean(0)
    u = [
        place[:, k] / np.abs(place[:, k]).max()
        for k in range(3)
        if np.ptp(place[:, k]) > 1e-6
    ]
    terms = [a * b for i, a in enumerate(u) for b in u[i:]] + [a**3 for a in u] + u
    yield [Push(dtip=t[:, None] * way) for t in terms for way in np.eye(3)]


def _signs(stage: Stage) -> Array:
    return np.asarray(np.sign(stage.motion.rate))


def _backlash(stage: Stage) -> Iterator[Block]:
    yield _per_leg(stage, _signs(stage))


def _friction(stage: Stage) -> Iterator[Block]:
    yield _per_leg(stage, _signs(stage) * stage.motion.q)


def _servo_lag(stage: Stage) -> Iterator[Block]:
    yield _per_leg(stage, stage.motion.rate)


def _encoder_scale(stage: Stage) -> Iterator[Block]:
    yield _per_leg(stage, stage.motion.q)


def _pitch_accumulation(stage: Stage) -> Iterator[Block]:
    terms = chebvander(stage.stroke, 6)[
        ..., 2:
    ]  # a constant and a slope are home error and scale
    yield [p for k in range(terms.shape[-1]) for p in _per_leg(stage, terms[..., k])]


def _waves(stage: Stage, periods: tuple[float, ...]) -> Iterator[Block]:
    for period in periods:
        phase = 2 * np.pi * stage.motion.q / period
        yield _per_leg(stage, np.sin(phase)) + _per_leg(stage, np.cos(phase))


def _screw_cyclic(stage: Stage) -> Iterator[Block]:
    pitches = (
        (5, 8, 10, 12, 16, 20, 25)
        if stage.machine.name != "planar"
        else (20, 25, 32, 40, 50)
    )
    yield from _waves(stage, tuple(1e-3 * p for p in pitches))


def _encoder_subdivision(stage: Stage) -> Iterator[Block]:
    yield from _waves(
        stage, tuple(1e-6 * p for p in (20, 40, 100, 200, 1000, 2000, 5000))
    )


def _guideway(stage: Stage) -> Iterator[Block]:
    block = []
    for leg in range(stage.machine.legs):
        terms = chebvander(stage.stroke[:, leg], 6)[:, 2:]
        for name in (f"side{leg + 1}", f"out{leg + 1}"):
            if name in stage.machine.extras:
                for k in range(terms.shape[1]):
                    dp = stage.zero()
                    dp[:, stage.machine.column(name)] = terms[:, k]
                    block.append(Push(dp=dp))
    yield block


def _joint_runout(stage: Stage) -> Iterator[Block]:
    for leg in range(stage.machine.legs):
        for platform in (False, True):
            v = stage.motion.leg[:, leg]
            v = np.einsum("nij,ni->nj", stage.motion.pose.R0, v) if platform else v
            way = np.linalg.svd(v - v.mean(0), full_matrices=False)[2][0]
            swing = np.arcsin(np.clip(v @ way, -1.0, 1.0))
            terms = [f(k * swing) for k in (1, 2, 4) for f in (np.cos, np.sin)]
            shifts = [t[:, None] * axis for t in terms for axis in np.eye(3)]
            yield [
                Push(dp=place_joints(stage, leg, s, platform=platform)) for s in shifts
            ]


def _joint_clearance(stage: Stage) -> Iterator[Block]:
    for share in (0.0, 0.3, 0.6):
        yield _per_leg(
            stage,
            np.asarray(
                np.sign(joint_force(stage, share * stage.machine.weight)), dtype=float
            ),
        )


def _bar_length(stage: Stage) -> Iterator[Block]:
    yield [Push(dy=stage.by_bar)]


def _bar_thermal(stage: Stage) -> Iterator[Block]:
    row = stage.layout.row
    for rise in [*_rises(stage), stage.climate.shown["temp_bar_C"]]:
        yield [Push(dy=rise[row] * stage.by_bar)]
    since = np.array(
        [
            stage.plan.time[stage.plan.setup == k].min()
            for k in range(len(stage.plan.setups))
        ]
    )
    for tau in TAUS[:3]:
        yield [
            Push(
                dy=np.exp(-(stage.plan.time - since[stage.plan.setup]) / tau)[row]
                * stage.by_bar
            )
        ]


def _drifts(stage: Stage, shape: Array) -> Block:
    block = []
    for k, setup in enumerate(stage.plan.setups):
        for column in setup.instrument.drifts:
            ds = np.zeros((stage.rows, STATE))
            ds[:, column] = shape * (stage.plan.setup == k)
            block.append(Push(ds=ds))
    return block


def _mount_drift(stage: Stage) -> Iterator[Block]:
    since = np.array(
        [
            stage.plan.time[stage.plan.setup == k].min()
            for k in range(len(stage.plan.setups))
        ]
    )
    t = stage.plan.time - since[stage.plan.setup]
    for tau in TAUS:
        yield _drifts(stage, t / t.max()) + _drifts(stage, 1.0 - np.exp(-t / tau))


def _step(stage: Stage) -> Iterator[Block]:
    t = stage.plan.time
    starts = [t[here[0]] - 0.5 for here in stage.plan.runs[1:]]
    for at in [*starts, *np.quantile(t, np.linspace(0.08, 0.92, 15))]:
        on = 1.0 * (t >= at)
        yield _per_leg(stage, np.repeat(on[:, None], stage.machine.legs, 1))


FORMS: dict[str, Callable[[Stage], Iterator[Block]]] = {
    "leg_thermal": _leg_thermal,
    "frame_thermal": _frame_thermal,
    "gravity": _gravity,
    "frame_bending": _frame_bending,
    "backlash": _backlash,
    "friction": _friction,
    "servo_lag": _servo_lag,
    "encoder_scale": _encoder_scale,
    "pitch_accumulation": _pitch_accumulation,
    "screw_cyclic": _screw_cyclic,
    "encoder_subdivision": _encoder_subdivision,
    "guideway": _guideway,
    "joint_runout": _joint_runout,
    "joint_clearance": _joint_clearance,
    "bar_length": _bar_length,
    "bar_thermal": _bar_thermal,
    "mount_drift": _mount_drift,
    "step": _step,
}


def distances(
    scene: Scene,
    stage: Stage,
    metric: Metric,
    names: tuple[str, ...],
    changes: list[Array],
) -> list[dict[str, float]]:
    """sqrt(lambda) of each difference of readings (N,) that named forms cannot absorb.

    The best alternative of each form counts, its sizes free.
    """
    vectors = [metric.embed(change) for change in changes]
    least: list[dict[str, float]] = [{} for _ in changes]
    for name in names:
        for block in FORMS[name](stage):
            responses = np.stack([scene.response(p) for p in block], -1)
            columns = metric.embed(responses)
            for by_name, vector in zip(least, vectors, strict=True):
                remaining = distance(vector, columns)
                by_name[name] = min(by_name.get(name, np.inf), remaining)
    return least
