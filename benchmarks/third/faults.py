"""Faults of machines as changes of their readings: 14 of the toolkit's list, 4 not.

A fault has parts, one for each drive, cup or axis; a case draws the size of each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from benchmarks.third import physics
from benchmarks.third.machines import RUNS, Array, Session, change

STEEL = 11.5e-6  # 1 / K
LEAD = 0.010  # m, of the screws
GRAIN = 10.0  # s, step of the session's clock
DOWN = np.array([0.0, 0.0, -1.0])


@dataclasses.dataclass(frozen=True)
class World:
    """What a session does to a machine, whatever faults it has."""

    s: Session  #: the session
    sensitivity: Array  #: tip displacement by joint displacement (n, 3, legs)
    load: Array  #: of each leg, N (n, legs), by platform and payload
    clock: Array  #: s, steps of GRAIN
    #: temperatures of each leg's motor and screw, of frame and bar, K over the start
    #: (len(clock), 2 legs + 2)
    heat: Array

    def at_readings(self, course: Array) -> Array:
        """A course over the clock at the times of the readings."""
        return np.asarray(np.interp(self.s.time, self.clock, course))


def world(s: Session, rng: np.random.Generator) -> World:
    """Loads and temperatures of a session."""
    step, none = 1e-6, np.zeros(len(s.time))
    tips = []
    for leg in range(s.machine.legs):
        q = s.q + step * (np.arange(s.machine.legs) == leg)
        tips.append(s.machine.tips(s, q, np.zeros(len(s.machine.sd)), none))
    nominal = s.machine.tips(s, s.q, np.zeros(len(s.machine.sd)), none)
    sensitivity = (np.stack(tips, -1) - nominal[..., None]) / step
    force = (s.machine.weight + s.payload)[:, None] * DOWN
    load = np.einsum("ni,nil->nl", force, sensitivity)
    clock = np.arange(0.0, s.time.max() + GRAIN, GRAIN)
    return World(s, sensitivity, load, clock, _heat(s, clock, rng))


def _heat(s: Session, clock: Array, rng: np.random.Generator) -> Array:
    """Each leg's motor and screw, frame and bar between the work and the room."""
    legs = s.machine.legs
    frame, bar = 2 * legs, 2 * legs + 1
    capacity = np.array([2e3, 1.5e3] * legs + [60e3, 400.0])
    to_room = np.array([1.5, 0.8] * legs + [8.0, 0.5])
    conductance = np.zeros((2 * legs + 2, 2 * legs + 2))
    for leg in range(legs):
        for a, b, value in ((2 * leg, 2 * leg + 1, 3.0), (2 * leg + 1, frame, 1.0)):
            conductance[a, b] = conductance[b, a] = value
    power = np.zeros((len(clock), 2 * legs + 2))
    power[:, : 2 * legs : 2] = work(clock, legs, rng)
    power[:, bar] = _hands(s, clock)
    drift = physics.ornstein_uhlenbeck(rng, len(clock), 200.0)
    room = 0.5 * (drift - drift[0]) + rng.uniform(-1, 1) * np.sin(clock / 5000.0)
    return physics.network(capacity, conductance, to_room, power, room, GRAIN)


def work(clock: Array, legs: int, rng: np.random.Generator) -> Array:
    """Loss of each motor, W (len(clock), legs): blocks of work and of rest."""
    on = np.zeros(len(clock))
    start = 0
    while start < len(clock):
        length = int(rng.integers(40, 160))
        on[start : start + length] = rng.choice([0.1, 1.0])
        start += length
    return np.asarray(on[:, None] * rng.uniform(10.0, 40.0, legs))


def _hands(s: Session, clock: Array) -> Array:
    """Heat of the hands that mount a bar: 5 W for a minute before each set-up."""
    starts = [s.time[s.setup == k].min() for k in np.unique(s.setup)]
    return 5.0 * np.any([(clock < t) & (clock > t - 60.0) for t in starts], axis=0)


Parts = list[Array]


def _each_leg(w: World, legs: Array) -> Parts:
    """One part a leg of changes (n, legs) of the joints."""
    count = w.s.machine.legs
    return [change(w.s, legs=legs * (np.arange(count) == k)) for k in range(count)]


def friction(w: World, rng: np.random.Generator) -> Parts:
    """LuGre friction winds up a drive beyond its encoder and disturbs its servo."""
    coulomb = np.abs(w.load).reshape(RUNS, -1, w.s.machine.legs).mean(1)
    coulomb = 30.0 * (1.0 + 0.3 * coulomb / coulomb.mean())
    bristle = 30.0 / rng.uniform(10e-6, 60e-6)
    time = w.s.path_time[..., None]
    force = physics.lugre(w.s.path_q, time, coulomb, bristle, rng.uniform(0.0, 400.0))
    wind_up = force / 10e6
    return _each_leg(w, w.s.of_readings(physics.servo_error(-force, time) - wind_up))


def backlash(w: World, rng: np.random.Generator) -> Parts:
    """Play of the nuts; beyond it the guides' friction presses on their flanks."""
    flank = rng.uniform(10.0, 40.0) / 50e6
    return _each_leg(w, w.s.of_readings(physics.play(w.s.path_q, 5e-6 + flank)))


def servo_lag(w: World, rng: np.random.Generator) -> Parts:
    """First-order loops whose feed-forward fits the mean drive and not each."""
    gain, time = rng.uniform(20.0, 50.0), w.s.path_time
    speed = np.gradient(w.s.path_q, axis=0) / np.gradient(time, axis=0)[..., None]
    lag = physics.relaxation(speed / gain, time[..., None], 1.0 / gain)
    return _each_leg(w, -w.s.of_readings(lag))


def leg_thermal(w: World, rng: np.random.Generator) -> Parts:
    """Screws grow between their thrust bearing and the nut."""
    courses = w.heat[:, 1 : 2 * w.s.machine.legs : 2]
    rises = np.stack([w.at_readings(c) for c in courses.T], -1)
    return _each_leg(w, STEEL * rises * w.s.q)


def frame_thermal(w: World, rng: np.random.Generator) -> Parts:
    return [change(w.s, frame=STEEL * w.at_readings(w.heat[:, -2]))]


def bar_thermal(w: World, rng: np.random.Generator) -> Parts:
    """A bar that is longer than its scale states reads too little."""
    length = 1e-3 * np.array([setup["bar_mm"] for setup in w.s.setups])
    rise = w.at_readings(w.heat[:, -1])
    return [change(w.s, reading=-STEEL * rise * length[w.s.setup])]


def bar_length(w: World, rng: np.random.Generator) -> Parts:
    return [change(w.s, reading=1e-6 * (w.s.setup == k)) for k in (0, 1)]


def mount_drift(w: World, rng: np.random.Generator) -> Parts:
    """A magnetic base creeps with the logarithm of time, and wanders."""
    parts = []
    for k in (0, 1):
        start = w.s.time[w.s.setup == k].min() - 60.0
        creep = np.log1p(np.maximum(w.clock - start, 0.0) / 120.0)
        wander = physics.ornstein_uhlenbeck(rng, len(w.clock), 150.0)
        course = w.at_readings(creep + 0.3 * np.cumsum(wander) / len(w.clock) * 10.0)
        active = 1e-6 * course * (w.s.setup == k)
        parts += [change(w.s, mount=active[:, None] * axis) for axis in np.eye(3)]
    return parts


def encoder_scale(w: World, rng: np.random.Generator) -> Parts:
    return _each_leg(w, 10e-6 * w.s.q)


def pitch_accumulation(w: World, rng: np.random.Generator) -> Parts:
    return _each_leg(w, 1e-6 * _screws(w, lambda q: physics.pitch_error(rng, q, LEAD)))


def screw_cyclic(w: World, rng: np.random.Generator) -> Parts:
    """A thrust bearing that wobbles: once and twice a turn, both grow and fade."""

    def wobble(q: Array) -> Array:
        turns = 2 * np.pi * q / LEAD
        growth = 1.0 + 0.3 * physics.pitch_error(rng, q, LEAD * 5.0) / 10.0
        first, second = rng.uniform(0.0, 2 * np.pi, 2)
        return growth * (np.sin(turns + first) + 0.3 * np.sin(2 * turns + second))

    return _each_leg(w, 1e-6 * _screws(w, wobble))


def _screws(w: World, error: Callable[[Array], Array]) -> Array:
    """Errors (n, legs) of one screw a leg."""
    return np.stack([error(q) for q in w.s.q.T], -1)


def gravity(w: World, rng: np.random.Generator) -> Parts:
    """Legs yield in their bearings as Hertz's law has it, beside the linear spring."""
    share = np.abs(w.load) / np.abs(w.load).mean()
    yielding = np.sign(w.load) * (share + 0.3 * share ** (2 / 3))
    return [change(w.s, legs=1e-6 * yielding)]


def joint_clearance(w: World, rng: np.random.Generator) -> Parts:
    """Joints in equilibrium within their clearance; springs take the mean load."""
    excess = w.load - w.load.mean(0)
    shift = physics.contact(excess, rng.uniform(4e-6, 10e-6))
    return _each_leg(w, shift)


def step(w: World, rng: np.random.Generator) -> Parts:
    """A reference mark or a cup jumps between two runs."""
    after = w.s.run >= rng.integers(2, RUNS - 1)
    after = after & (w.s.setup == w.s.setup[after][0])
    legs = _each_leg(w, 1e-6 * np.repeat(after[:, None], w.s.machine.legs, 1))
    moved = 1e-6 * after[:, None]
    return legs + [change(w.s, mount=moved * axis) for axis in np.eye(3)]


def tool_tilt(w: World, rng: np.random.Generator) -> Parts:
    """A clamped tool tilts in its taper, which creeps under the pull of a hose."""
    anchor = np.append(rng.uniform(-0.5, 0.5, 2), 1.0)
    pull = anchor - w.s.path_points
    time = w.s.path_time[..., None]
    tilt = physics.relaxation(pull[..., :2], time, rng.uniform(15.0, 90.0))
    tool = np.zeros((len(w.s.time), 3))
    tool[:, :2] = 1e-6 * w.s.of_readings(tilt)
    return [change(w.s, tool=tool)]


def cable_drag(w: World, rng: np.random.Generator) -> Parts:
    """A hose hangs on the platform: a spring, and friction within its sheath."""
    anchor = np.append(rng.uniform(-0.6, 0.6, 2), 1.2)
    away = anchor - w.s.path_points
    reach = np.linalg.norm(away, axis=-1, keepdims=True)
    spring = 40.0 * (reach - 0.8 * reach.min()) * away / reach
    time = w.s.path_time[..., None]
    drag = physics.lugre(w.s.path_points, time, np.full((RUNS, 3), 8.0), 8.0 / 20e-3)
    force = w.s.of_readings(spring - drag)
    legs = np.einsum("ni,nil->nl", force, w.sensitivity) / 20e6
    return [change(w.s, legs=legs)]


def pressure_ripple(w: World, rng: np.random.Generator) -> Parts:
    """Balancing cylinders push with the supply's pressure, each as its friction lets."""
    course = w.at_readings(physics.pressure(rng, len(w.clock) * 5, GRAIN / 5)[::5])
    shares = rng.uniform(0.3, 1.0, w.s.machine.legs)
    return [change(w.s, legs=1e-6 * course[:, None] * shares)]


def gear_cyclic(w: World, rng: np.random.Generator) -> Parts:
    """Eccentric wheels of a gear between motor and screw: no whole ratios of a turn."""
    ratio = rng.choice([17 / 37, 23 / 41, 53 / 19])

    def wheels(q: Array) -> Array:
        turns = 2 * np.pi * q / (LEAD * ratio)
        first, second = rng.uniform(0.0, 2 * np.pi, 2)
        return np.sin(turns + first) + 0.4 * np.sin(3 * turns + second) ** 3

    return _each_leg(w, 1e-6 * _screws(w, wheels))


Fault = Callable[[World, np.random.Generator], Parts]
#: faults whose sizes have no sign of their own
SIGNED = {"servo_lag", "bar_length", "mount_drift", "encoder_scale", "step"}
_OF_ALL: tuple[Fault, ...] = (
    friction, backlash, servo_lag, leg_thermal, frame_thermal, encoder_scale,
    pitch_accumulation, screw_cyclic, gravity, joint_clearance,
)  # fmt: skip
#: a line's own reference takes up a step between two lines
_OF_BARS: tuple[Fault, ...] = (step, bar_thermal, bar_length, mount_drift)
NEVER_LISTED: dict[str, Fault] = {
    f.__name__: f for f in (tool_tilt, cable_drag, pressure_ripple, gear_cyclic)
}


def listed(machine: str) -> dict[str, Fault]:
    """Faults that the toolkit lists and that this machine or its instrument can have."""
    faults = _OF_ALL if machine == "planar" else _OF_ALL + _OF_BARS
    return {f.__name__: f for f in faults}


def sizes(name: str, count: int, rng: np.random.Generator) -> Array:
    """Sizes of the parts of a fault; half of the faults lie in one part mostly."""
    values = rng.lognormal(0.0, 0.5, count)
    if name in SIGNED:
        values *= rng.choice([-1.0, 1.0], count)
    if name == "step" or rng.random() < 0.5:
        values *= np.where(np.arange(count) == rng.integers(count), 1.0, 0.1)
        if name == "step":
            values *= np.abs(values) == np.abs(values).max()
    return np.asarray(values)
