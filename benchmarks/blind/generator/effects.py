"""Effects, each with a form that departs from the textbook, and which machine has which.

Heat: bodies warm with two time constants each (motor and nut fast, castings slow), legs
unequally; sensors sit at one place and lag. Effects of moving remember, saturate or
spread. Twelve effects are in nobody's library.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from benchmarks.blind.generator.machines import Array, Machine, joint_columns
from benchmarks.blind.generator.plans import (
    BARS,
    STATE,
    TEMPERATURES,
    Index,
    Plan,
    Setup,
)
from benchmarks.blind.generator.scene import Layout, Motion, Push


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """An effect with its form drawn; only its size is open."""

    name: str
    #: amplitude (m, the largest addition to a joint, a place, a reading) -> what it
    #: adds
    push: Callable[[float], Push]
    #: where it acts, if it acts in part: "leg 2", "time 7200-9000", "run C3",
    #: "direction +1", "phase 30-80"
    blocks: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Climate:
    """Temperature rises, K: of legs (n, legs), frame and bar (n,); `shown` by sensors."""

    leg: Array
    frame: Array
    bar: Array
    shown: dict[str, Array]


@dataclasses.dataclass(frozen=True)
class Stage:
    """What an effect may depend on."""

    plan: Plan
    motion: Motion
    layout: Layout
    climate: Climate

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.plan.machine

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.plan.command)

    @property
    def stroke(self) -> Array:
        """Each leg's place in its range of this plan, -1..1, (n, legs)."""
        q = self.motion.q
        low, high = q.min(0), q.max(0)
        return np.asarray((2 * q - low - high) / (high - low))

    @property
    def by_bar(self) -> Array:
        """1 for readings (N,) of a ball bar, 0 for others."""
        bars = np.array([s.instrument.name in BARS for s in self.plan.setups]) * 1.0
        return np.asarray(bars[self.plan.setup[self.layout.row]])

    def zero(self) -> Array:
        """dp (n, np + extras) of nothing."""
        return np.zeros((self.rows, len(self.machine.full)))


def unit(push: Push) -> Push:
    """A push scaled to a largest addition of 1 m. Raises ArithmeticError without any."""
    peak = push.peak()
    if not peak > 0 or not np.isfinite(peak):
        raise ArithmeticError("this form of the effect does nothing on this plan")
    return push.times(1.0 / peak)


def linear(name: str, push: Push, blocks: tuple[str, ...] = ()) -> Effect:
    """An effect proportional to its amplitude."""
    return Effect(name=name, push=unit(push).times, blocks=blocks)


def pick_legs(
    rng: Generator, count: int, single: float = 0.5
) -> tuple[Array, tuple[str, ...]]:
    """Gains (legs,) with the blocks: of one leg (probability `single`), or all unequal."""
    if rng.random() < single:
        leg = int(rng.integers(count))
        return np.eye(count)[leg], (f"leg {leg + 1}",)
    return np.clip(1.0 + 0.3 * rng.normal(size=count), 0.3, 1.8), ()


def some_legs(rng: Generator, count: int) -> tuple[list[int], tuple[str, ...]]:
    """One leg with probability 0.6, else all; and the blocks."""
    if rng.random() < 0.6:
        leg = int(rng.integers(count))
        return [leg], (f"leg {leg + 1}",)
    return list(range(count)), ()


def place_joints(stage: Stage, leg: int, shift: Array, *, platform: bool) -> Array:
    """dp (n, np + extras) that moves a leg's base joint (or carriage), or its platform
    joint, by shift (n, 3).

    Machines whose carriages run on guides take the components that these have: planar
    sideways and along; delta outward, sideways and along; the hexaglide along, across
    and up.
    """
    base, local = joint_columns(stage.machine, leg)
    columns = local if platform and local else base
    dp = stage.zero()
    dp[:, columns] = shift[:, : len(columns)]
    return dp


def some_way(rng: Generator, machine: Machine, size: Array) -> Array:
    """Displacements (n, 3) of sizes (n,) along one direction, in a planar machine's plane."""
    way = rng.normal(size=3)
    if machine.name == "planar":
        way[0] = 0.0
    return np.asarray(size[:, None] * way / np.linalg.norm(way))


def moved_mount(rng: Generator, setup: Setup, course: Array) -> Array:
    """State (n, STATE) of a set-up whose mount drifts some way along a course (n,)."""
    drifts = list(setup.instrument.drifts)
    way = rng.normal(size=len(drifts))
    state = np.zeros((len(course), STATE))
    state[:, drifts] = course[:, None] * way / np.linalg.norm(way)
    return state


def smooth(rng: Generator, u: Array, knots: int = 6) -> Array:
    """A random smooth curve over u in -1..1: natural cubic, values at uneven knots."""
    inner = np.sort(rng.uniform(-0.9, 0.9, knots - 2))
    at = np.concatenate([[-1.0], inner, [1.0]])
    at += np.linspace(0.0, 0.05, knots)  # never twice the same
    curve = CubicSpline(at, rng.normal(size=knots), bc_type="natural")
    return np.asarray(curve(np.clip(u, -1.0, 1.05)))


def spans(plan: Plan) -> float:
    """Last time of the plan, s."""
    return float(plan.time.max())


# -- heat ------------------------------------------------------------------------------
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
        during = (t >= plan.time[here[0]] - GRID) & (t <= plan.time[here[-1]])
        busy[during] += 0.5 * np.sqrt(plan.feed[here[0]] / plan.feed.max())
    fast = _lagged(busy, rng.uniform(400.0, 1500.0))
    slow = _lagged(busy, rng.uniform(3600.0, 9000.0))
    share = rng.uniform(0.25, 0.75, plan.machine.legs)
    gain = np.clip(1.0 + 0.25 * rng.normal(size=plan.machine.legs), 0.4, 1.7)
    gain = gain * rng.uniform(4.0, 9.0)
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
        fading = np.exp(-(t - start + GRID) / rng.uniform(700.0, 2400.0))
        hand += np.where(t >= start - GRID, fading, 0.0)
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
    for name, body in zip(TEMPERATURES, (leg, frame, bar), strict=True):
        lagged = body[0] + _lagged(body - body[0], rng.uniform(120.0, 600.0))
        reading = rng.uniform(0.8, 1.1) * np.interp(plan.time, t, lagged)
        reading = reading + rng.normal(0.0, 0.2)
        shown[name] = np.round(reading + rng.normal(0.0, 0.05, len(reading)), 1)
    return shown


def leg_thermal(rng: Generator, stage: Stage) -> Effect:
    """Screws grow between nut and bearing; each leg mixes two time constants."""
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.4)
    q = stage.motion.q
    fixed = rng.uniform(0.0, 0.25) * q.min()
    dq = gains * (q - fixed) * stage.climate.leg
    return linear("leg_thermal", Push(dq=dq), blocks)


def frame_thermal(rng: Generator, stage: Stage) -> Effect:
    """The frame grows with a gradient: one side is nearer to the heat."""
    side = rng.normal(size=stage.machine.legs)
    spread = 1.0 + rng.uniform(0.1, 0.5) * side / np.abs(side).max()
    dp = stage.climate.frame[:, None] * stage.machine.growth(spread)
    return linear("frame_thermal", Push(dp=dp))


def bar_thermal(rng: Generator, stage: Stage) -> Effect:
    """The bar is warm from the hand, follows the room, and reads that much less."""
    dy = -0.3 * stage.climate.bar[stage.layout.row] * stage.by_bar
    return linear("bar_thermal", Push(dy=dy))


# -- weight and payload ----------------------------------------------------------------
def joint_force(stage: Stage, weight: float) -> Array:
    """Force (n, legs), N, of each joint: payload at the tool, weight at its centre."""
    motion = stage.motion
    payload = stage.plan.payload[:, None]
    return np.asarray(payload * motion.lift + weight * motion.lift_com)


def gravity(rng: Generator, stage: Stage) -> Effect:
    """Legs shorten under force: longer ones more, stiffer under load, none alike."""
    machine, q = stage.machine, stage.motion.q
    weight = machine.weight * rng.uniform(0.6, 1.4)
    force = joint_force(stage, weight)
    typical = float(np.abs(force).mean())
    harden = rng.uniform(0.0, 0.35)
    load = force * (np.abs(force) / typical + 0.05) ** -harden
    long = rng.uniform(0.2, 1.2), (q / q.mean(0)) ** rng.choice([1.0, 2.0, 3.0])
    slender = 1.0 + long[0] * (long[1] - 1.0)
    legs = np.clip(1.0 + 0.15 * rng.normal(size=machine.legs), 0.6, 1.4)
    dq = -load * slender * legs
    return linear("gravity", Push(dq=dq))


def frame_bending(rng: Generator, stage: Stage) -> Effect:
    """A smooth field of displacement that no joint explains: a few bent modes."""
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
        angle = rng.uniform(0.5, 1.5) * mix + rng.uniform(0, 2 * np.pi)
        bow = np.tanh(mix) * np.cos(angle)
        mode = 0.4 * bow + mix**2
        field += mode[:, None] * rng.normal(size=3)
    payload = stage.plan.payload
    sag = 1.0 + rng.uniform(0.0, 0.5) * payload / max(float(payload.max()), 1.0)
    if stage.machine.name == "planar":
        field[:, 0] = 0.0
    return linear("frame_bending", Push(dtip=field * sag[:, None]))


def guideway(rng: Generator, stage: Stage) -> Effect:
    """A carriage leaves its line: bows, a joint between two rails, a short wave."""
    machine = stage.machine
    legs, blocks = some_legs(rng, machine.legs)
    dp = stage.zero()
    for leg in legs:
        u = stage.stroke[:, leg]
        for name in ("side",) if machine.name == "planar" else ("out", "side"):
            bow = smooth(rng, u, int(rng.integers(4, 8)))
            kink = rng.uniform(0.0, 0.8) * np.tanh((u - rng.uniform(-0.6, 0.6)) / 0.05)
            dp[:, machine.column(f"{name}{leg + 1}")] = bow + kink
    return linear("guideway", Push(dp=dp), blocks)


# -- moving ----------------------------------------------------------------------------
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
            curve = CubicSpline(np.arange(len(ring)), ring, bc_type="periodic")
            slope = curve(np.arange(len(here)), 1)
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
    """Extremum (m, legs) of the cubic between neighbours, or the middle without one."""
    a, b = 2 * (q0 - q1) + m0 + m1, 3 * (q1 - q0) - 2 * m0 - m1
    # root of 3 a t^2 + 2 b t + m0 in 0..1, in the form that is safe for small a
    root = np.sqrt(np.maximum(b**2 - 3 * a * m0, 0.0))
    below, middle = b + np.where(m1 >= m0, root, -root), np.full_like(q0, 0.5)
    t = np.clip(np.divide(-m0, below, out=middle, where=m0 * m1 < 0), 0.0, 1.0)
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
    """Several gaps in a row; amplitude is half the total gap of the loosest leg."""
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

    return Effect(name="backlash", push=push, blocks=blocks)


def friction(rng: Generator, stage: Stage) -> Effect:
    """Wind-up of a compliant drive: Dahl's presliding, Stribeck, drag by stroke."""
    gains, blocks = pick_legs(rng, stage.machine.legs)
    q, rate = stage.motion.q, stage.motion.rate
    # m, presliding of drives
    slide = float(np.exp(rng.uniform(np.log(0.03e-3), np.log(0.6e-3))))
    height, turns = rng.uniform(0.05, 0.2), rng.uniform(1.5, 4.0) * stage.stroke
    swing = height * np.sin(turns + rng.uniform(0, 2 * np.pi))
    slow = np.median(np.abs(rate)) * rng.uniform(0.2, 0.8)
    stribeck = 1.0 + rng.uniform(0.05, 0.3) * np.exp(-np.abs(rate) / slow)
    level = (1.0 + swing) * stribeck
    yielding = 1.0 + rng.uniform(0.5, 1.5) * (q - q.mean(0)) / q.mean(0)
    dq = -gains * level * yielding * _dahl(stage, slide)
    return linear("friction", Push(dq=dq), blocks)


def _dahl(stage: Stage, slide: float) -> Array:
    """Wound-up share (n, legs), -1..1, which follows the travel after `slide`, m."""
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
    """Following error with feed-forward: rate, saturating, and acceleration parts."""
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.4)
    rate, acc = stage.motion.rate, stage.motion.acceleration
    top = float(np.abs(rate).max())
    curve = rng.uniform(0.0, 0.35)
    lag = rate * (1.0 - curve * np.abs(rate) / top)
    share = np.abs(lag).max() / max(float(np.abs(acc).max()), 1e-12)
    second = rng.uniform(-0.4, 0.4) * acc * share
    return linear("servo_lag", Push(dq=-gains * (lag + second)), blocks)


def joint_clearance(rng: Generator, stage: Stage) -> Effect:
    """Joints settle softly on a side of their gap by the force, and a little aside."""
    gains, blocks = pick_legs(rng, stage.machine.legs)
    force = joint_force(stage, rng.uniform(0.0, 0.6) * stage.machine.weight)
    soft = np.tanh(force / (rng.uniform(0.02, 0.15) * np.abs(force).max(0)))
    aside = rng.uniform(0.0, 0.2) * stage.stroke * np.abs(soft)
    return linear("joint_clearance", Push(dq=-gains * (soft + aside)), blocks)


# -- length: errors that repeat with a leg's length or a joint's angle -----------------
def encoder_scale(rng: Generator, stage: Stage) -> Effect:
    """A scale that is not quite uniform: its uniform part hides in the geometry."""
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.6)
    u = stage.stroke
    bend = rng.uniform(-0.04, 0.04) * float(np.ptp(stage.motion.q)) / 2
    dq = gains * (stage.motion.q + bend * (u**2 + 0.4 * u**3))
    return linear("encoder_scale", Push(dq=dq), blocks)


def common_scale(rng: Generator, stage: Stage) -> Effect:
    """The same scale error in every leg: on one bar and tool like the bar's length."""
    return linear("encoder_scale", Push(dq=stage.motion.q.copy()))


def pitch_accumulation(rng: Generator, stage: Stage) -> Effect:
    """Lead error of a screw: accumulated pitch errors, and one worn stretch."""
    gains, blocks = pick_legs(rng, stage.machine.legs, 0.6)
    u = stage.stroke
    dq = np.zeros_like(u)
    for leg in range(u.shape[1]):
        curve = smooth(rng, u[:, leg], int(rng.integers(5, 9)))
        size, place = rng.uniform(0.0, 1.2), rng.uniform(-0.6, 0.6)
        worn = size * np.exp(-(((u[:, leg] - place) / 0.25) ** 2))
        dq[:, leg] = gains[leg] * (curve + worn)
    return linear("pitch_accumulation", Push(dq=dq), blocks)


def _harmonics(rng: Generator, phase: Array, orders: tuple[int, ...]) -> Array:
    wave = np.sin(phase + rng.uniform(0, 2 * np.pi))
    for order in orders:
        size = rng.uniform(0.1, 0.5)
        wave = wave + size * np.sin(order * phase + rng.uniform(0, 2 * np.pi))
    return np.asarray(wave)


def screw_cyclic(rng: Generator, stage: Stage) -> Effect:
    """Once and more per turn of the screw; the amplitude changes along it."""
    pitches: tuple[float, ...] = (5.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0)
    if stage.machine.name == "planar":
        pitches = (20.0, 25.0, 32.0, 40.0, 50.0)
    pitch = float(rng.choice(pitches)) * 1e-3
    gains, blocks = pick_legs(rng, stage.machine.legs)
    u = stage.stroke
    dq = np.zeros_like(u)
    for leg in range(u.shape[1]):
        orders = (2, 3) if rng.random() < 0.5 else (2,)
        wave = _harmonics(rng, 2 * np.pi * stage.motion.q[:, leg] / pitch, orders)
        dq[:, leg] = gains[leg] * wave * (1.0 + rng.uniform(-0.3, 0.3) * u[:, leg])
    return linear("screw_cyclic", Push(dq=dq), blocks)


def encoder_subdivision(rng: Generator, stage: Stage) -> Effect:
    """Interpolation within a grating's period: offset and amplitude of sine, cosine."""
    fine = {"planar": (40, 100, 200), "delta": (1000, 2000, 5000)}
    period = float(rng.choice(fine.get(stage.machine.name, (20, 40, 100)))) * 1e-6
    gains, blocks = pick_legs(rng, stage.machine.legs)
    dq = np.zeros_like(stage.motion.q)
    for leg in range(dq.shape[1]):
        phase = 2 * np.pi * stage.motion.q[:, leg] / period
        dq[:, leg] = gains[leg] * _harmonics(rng, phase, (2, 4))
    return linear("encoder_subdivision", Push(dq=dq), blocks)


def joint_runout(rng: Generator, stage: Stage) -> Effect:
    """A joint's centre wanders as it swings: harmonics of the leg's direction."""
    chosen, blocks = some_legs(rng, stage.machine.legs)
    platform = bool(rng.random() < 0.5)
    total = stage.zero()
    for leg in chosen:
        v = stage.motion.leg[:, leg]
        direction = np.einsum("nij,ni->nj", stage.motion.pose.R0, v) if platform else v
        mean = direction.mean(0) / np.linalg.norm(direction.mean(0))
        swing = np.arctan2(direction @ _across(direction), np.abs(direction @ mean))
        shift = np.zeros((stage.rows, 3))
        # eccentricity, ovality, and the waviness of rolling elements
        for axis in range(3):
            for orders, size in (((1, 2), 1.0), ((2, 3), 0.7), ((8, 12, 16), 0.15)):
                wave = np.cos(swing * rng.choice(orders) + rng.uniform(0, 2 * np.pi))
                shift[:, axis] += size * rng.normal() * wave
        total += place_joints(stage, leg, shift, platform=platform)
    return linear("joint_runout", Push(dp=total), blocks)


def _across(v: Array) -> Array:
    """The direction (3,) in which the unit vectors v (n, 3) swing most."""
    return np.asarray(np.linalg.svd(v - v.mean(0), full_matrices=False)[2][0])


# -- mounts and sudden changes ---------------------------------------------------------
def bar_length(rng: Generator, stage: Stage) -> Effect:
    """The bar's calibration is off: every reading by the same length."""
    return linear("bar_length", Push(dy=stage.by_bar))


def mount_drift(rng: Generator, stage: Stage) -> Effect:
    """A mount creeps after clamping, fast and slow, and may slip; set-ups differ."""
    plan = stage.plan
    ds = np.zeros((stage.rows, STATE))
    only = None
    if len(plan.setups) > 1 and rng.random() < 0.4:
        only = int(rng.integers(len(plan.setups)))
    for k, setup in enumerate(plan.setups):
        if only is not None and k != only:
            continue
        here = np.flatnonzero(plan.setup == k)
        t = plan.time[here] - plan.time[here[0]]
        fast = np.log1p(t / rng.uniform(300.0, 3000.0))
        creep = fast + rng.uniform(0.0, 0.6) * t / max(float(t.max()), 1.0)
        slip = rng.uniform(0.0, 0.3) * creep.max()
        slip = slip * (t > rng.uniform(0.2, 0.9) * t.max())
        ds[here] = moved_mount(rng, setup, creep + slip)
    runs = set(plan.run[(plan.setup == only) & (plan.run >= 0)].tolist())
    blocks = tuple(f"run {plan.run_name(r)}" for r in sorted(runs))
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
    first = inside if rng.random() < 0.3 else plan.runs[run][0]  # mostly between runs
    at = float(plan.time[first]) - 1.0
    rows = 1.0 * (plan.time >= at)
    end = last
    if rng.random() < 0.4:
        back, gone = at + rng.uniform(0.1, 0.6) * (last - at), rng.uniform(0.3, 1.0)
        rows = rows - gone * (plan.time >= back)
        end = back if gone > 0.5 else last
    blocks: tuple[str, ...] = (f"time {at:.0f}-{end:.0f}",)
    # the mounts of the planar machine are zeroed with every run
    if rng.random() < 0.75 or stage.machine.name == "planar":
        leg = int(rng.integers(stage.machine.legs))
        dq = np.zeros_like(stage.motion.q)
        dq[:, leg] = rows
        return linear("step", Push(dq=dq), (*blocks, f"leg {leg + 1}"))
    ds = np.zeros((stage.rows, STATE))
    for k, setup in enumerate(plan.setups):
        here = plan.setup == k
        ds[here] = moved_mount(rng, setup, rows[here])
    return linear("step", Push(ds=ds), blocks)


# -- in nobody's library ---------------------------------------------------------------
def cross_talk(rng: Generator, stage: Stage) -> Effect:
    """One leg's current disturbs another: force of one by the rate of the next."""
    legs = stage.machine.legs
    a, b = rng.choice(legs, 2, replace=False)
    other = stage.motion.rate[:, b] / np.abs(stage.motion.rate[:, b]).max()
    dq = np.zeros_like(stage.motion.q)
    along = 1.0 + stage.stroke[:, a] * rng.uniform(0.3, 1.0)
    dq[:, a] = other * along + 0.4 * np.abs(other)
    return linear("cross_talk", Push(dq=dq), (f"leg {a + 1}",))


def feed_resonance(rng: Generator, stage: Stage) -> Effect:
    """The structure rings at one feed: a wave along the path, largest where it bends."""
    feeds = np.unique(stage.plan.feed[stage.plan.feed > 0])
    feed = feeds[-1] if rng.random() < 0.7 else feeds[0]
    wave = feed * rng.uniform(2.0, 7.0)  # m of path a cycle: aliased by the readings
    shape = np.sin(2 * np.pi * stage.motion.arc / (wave * 0.37) + rng.uniform(0, 6.28))
    swell = 1.0 + 0.6 * np.sin(2 * stage.plan.phase + rng.uniform(0, 6.28))
    on = np.isclose(stage.plan.feed, feed)
    field = some_way(rng, stage.machine, on * swell * (0.5 + shape))
    runs = sorted(set(stage.plan.run[on].tolist())) if len(feeds) > 1 else []
    blocks = tuple(f"run {stage.plan.run_name(r)}" for r in runs)
    return linear("feed_resonance", Push(dtip=field), blocks)


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
    return linear("spindle_growth", Push(dtip=field), tuple(blocks))


def humidity_wave(rng: Generator, stage: Stage) -> Effect:
    """A composite swells one way with the room's moisture, a slow wave of hours."""
    t = stage.plan.time
    wave = np.zeros_like(t)
    for size, hours in ((1.0, (1.5, 4.0)), (0.4, (0.7, 1.5))):
        turn = 2 * np.pi * t / (3600.0 * rng.uniform(*hours))
        wave += size * np.sin(turn + rng.uniform(0, 6.28))
    total = stage.zero()
    for leg in range(stage.machine.legs):
        shift = np.ones((stage.rows, 1)) * rng.normal(size=3)
        total += place_joints(stage, leg, shift, platform=True)
    return linear("humidity_wave", Push(dp=total * wave[:, None]))


def cable_drag(rng: Generator, stage: Stage) -> Effect:
    """A cable pulls the tool aside by where it points, differently on the way back."""
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
    """The platform twists: joints move sideways by the product of two legs' forces."""
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
    sigma = stage.layout.sigma
    return linear("interference", Push(dy=wave * channel * sigma / sigma.max()))


def table_sag(rng: Generator, stage: Stage) -> Effect:
    """The table gives way under the tool's place, and the mount on it leans."""
    place = stage.motion.tip
    reach = max(float(np.ptp(place, axis=0).max()), 1e-9)
    centre = place[int(rng.integers(stage.rows))]
    wide = rng.uniform(0.1, 0.22) * reach
    dip = np.exp(-((place - centre) ** 2).sum(-1) / wide**2)
    ds = np.zeros((stage.rows, STATE))
    for k, setup in enumerate(stage.plan.setups):
        here = stage.plan.setup == k
        way = rng.normal(size=len(setup.instrument.drifts))
        ds[np.ix_(here, setup.instrument.drifts)] = dip[here, None] * way
    return linear("table_sag", Push(ds=ds))


def wrong_table(rng: Generator, stage: Stage) -> Effect:
    """A patch of the controller's compensation table is wrong, for two legs."""
    legs = stage.machine.legs
    a, b = rng.choice(legs, 2, replace=False)
    centre = stage.stroke[int(rng.integers(stage.rows))]
    away = np.abs(stage.stroke[:, [a, b]] - centre[[a, b]])
    near = np.exp(-(away**4) / rng.uniform(0.2, 0.3) ** 4)
    dq = np.zeros_like(stage.motion.q)
    dq[:, a], dq[:, b] = near.prod(1), rng.uniform(-1.0, 1.0) * near.prod(1)
    return linear("wrong_table", Push(dq=dq), (f"leg {a + 1}", f"leg {b + 1}"))


def pump(rng: Generator, stage: Stage) -> Effect:
    """A coolant pump switches on and off and moves everything a little while it runs."""
    t, last = stage.plan.time, spans(stage.plan)
    cycle, share = rng.uniform(0.06, 0.15) * last, rng.uniform(0.3, 0.7)
    on = ((t / cycle + rng.random()) % 1.0) < share
    dq = on[:, None] * rng.normal(size=stage.machine.legs) * (1.0 + 0.5 * stage.stroke)
    return linear("pump", Push(dq=dq))


def run_in(rng: Generator, stage: Stage) -> Effect:
    """Each run begins unsettled: oil film and servo take some readings to come to rest."""
    fade = np.zeros(stage.rows)
    lengths = rng.uniform(1.5, 4.5)
    for here in stage.plan.runs:
        fade[here] = np.exp(-np.arange(len(here)) / lengths) * rng.uniform(0.6, 1.4)
    return linear("run_in", Push(dtip=some_way(rng, stage.machine, fade)))


def stick(rng: Generator, stage: Stage) -> Effect:
    """A cover rubs in one sector, one way only."""
    way = 1.0 if rng.random() < 0.5 else -1.0
    phase = stage.plan.phase
    centre = rng.choice(phase[stage.plan.run >= 0])
    round_trip = np.ptp(phase) > 3.0
    wide, gap = (0.5 if round_trip else 0.2), phase - centre
    if round_trip:
        gap = np.angle(np.exp(1j * gap))
    patch = np.exp(-((gap / wide) ** 2)) * (stage.plan.direction == way)
    dq = patch[:, None] * rng.normal(size=stage.machine.legs)
    blocks: tuple[str, ...] = (f"direction {way:+.0f}",)
    if round_trip:
        ends = np.rad2deg(centre + 1.2 * wide * np.array([-1.0, 1.0]))
        low, high = ends % 360
        blocks = (*blocks, f"phase {low:.0f}-{high:.0f}")
    return linear("stick", Push(dq=dq), blocks)


# -- by name ---------------------------------------------------------------------------
Form = Callable[[Generator, Stage], Effect]

_KNOWN: tuple[Form, ...] = (
    leg_thermal, frame_thermal, gravity, frame_bending, backlash, friction, servo_lag,
    encoder_scale, pitch_accumulation, screw_cyclic, encoder_subdivision, guideway,
    joint_runout, joint_clearance, bar_length, bar_thermal, mount_drift, step,
)  # fmt: skip
_UNKNOWN: tuple[Form, ...] = (
    cross_talk, feed_resonance, spindle_growth, humidity_wave, cable_drag,
    platform_torsion, interference, table_sag, wrong_table, pump, run_in, stick,
)  # fmt: skip
KNOWN = {f.__name__: f for f in _KNOWN}
UNKNOWN = {f.__name__: f for f in _UNKNOWN}
#: the exact class: one bar and one tool cannot tell these two
EXACT: dict[str, Form] = {"encoder_scale": common_scale, "bar_length": bar_length}

_BARS = ("bar_length", "bar_thermal")
#: sliders have guideways, bars need a ball bar, gaps need a pull; relative readings of
#: a minute see no mount creep
_ABSENT = {
    "a3": ("guideway",),
    "hexapod": ("guideway",),
    "planar": (*_BARS, "joint_clearance", "mount_drift", "spindle_growth"),
    "delta": (*_BARS, "joint_clearance"),
}


def known_on(machine: str) -> tuple[str, ...]:
    """Known effects that a machine can have."""
    return tuple(n for n in KNOWN if n not in _ABSENT[machine])


def unknown_on(machine: str) -> tuple[str, ...]:
    """Unknown effects that a machine can have."""
    return tuple(n for n in UNKNOWN if n not in _ABSENT[machine])
