"""Terms that several effects share: where a joint is in its travel, warming up, what a
metre is worth in a joint.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from oed.base import Array, curve_mode
from oed.effect_model import Column, State
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine

STEEL_EXPANSION = 11.5e-6  # 1/K, thermal expansion (ISO 230-3)
#: time constants of warming up, s: a motor's housing half an hour, a machine frame four
#: hours (ISO 230-3, annex)
TIME_CONSTANTS = (1800.0, 3600.0, 7200.0, 14400.0)
#: how much smaller a column that only lets the form adapt is expected to be than the
#: textbook's
SHAPE_SHARE = 0.4
#: weight of what moves over the heaviest payload: that of a printer is 10 N, of a
#: hexapod 2 kN, and payloads go with it
MASS_RATIOS = (0.3, 1.0, 3.0, 10.0)
#: correlation length of an error along a joint's travel, over half the travel read
CORRELATION_LENGTH = 0.5
N_CURVES = 10  #: modes that describe such an error
#: least part of a joint's whole travel over which its error is a curve of its own
MIN_TRAVEL_SHARE = 0.25
CACHE_SIZE = 32


@dataclasses.dataclass(frozen=True, slots=True)
class Travel:
    """Of a nominal machine, over the corners and the middle of its workspace; nq
    joints, SI.

    low, high (nq,)   least and largest value of each joint
    strut (nq,)       mean length of its strut, NaN where the machine does not tell it
    guide (nq, 3)     direction in which a joint moves the base end of its strut; 0 for
                      a strut that changes its length
    """

    low: Array
    high: Array
    strut: Array
    guide: Array


@dataclasses.dataclass(frozen=True)
class _Key:
    """What the travel of a machine depends on; two machines that agree in it share it."""

    machine: Machine = dataclasses.field(compare=False, hash=False)
    definition: tuple[object, ...]
    numbers: bytes


def travel(machine: Machine) -> Travel:
    """The machine's travel, remembered."""
    definition = (machine.closure, machine.target, machine.guess, machine.struts)
    workspace = [(c.lower, c.upper) for c in machine.workspace()]
    numbers = (machine.nominal, machine.home_command, np.array(workspace))
    return _travel(_Key(machine, definition, b"".join(n.tobytes() for n in numbers)))


@functools.lru_cache(maxsize=CACHE_SIZE)
def _travel(key: _Key) -> Travel:
    machine = key.machine
    kinematics = Kinematics(machine)
    p = machine.nominal
    levels = 5 if len(machine.command) <= 3 else 3
    sides = [np.linspace(c.lower, c.upper, levels) for c in machine.workspace()]
    command = np.vstack([machine.home_command, *itertools.product(*sides)])
    x, q = _reached(kinematics, command[np.isfinite(command).all(axis=1)])
    low, high = q.min(axis=0), q.max(axis=0)
    if machine.struts is None:
        return Travel(low, high, np.full(len(low), np.nan), np.zeros((len(low), 3)))
    step = 1e-3 * (high - low)
    base, platform, _ = kinematics.struts(x, q, p)
    moved, _, _ = kinematics.struts(x, q + step, p)
    shift = ((moved - base) / step[:, None]).mean(axis=0)
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    guide = np.where(length > 1e-6, shift / np.maximum(length, 1e-6), 0.0)
    return Travel(
        low, high, np.linalg.norm(platform - base, axis=-1).mean(axis=0), guide
    )


def _reached(kinematics: Kinematics, command: Array) -> tuple[Array, Array]:
    """Poses and joints of the commands within reach; the first, home, is."""
    while True:
        try:
            return kinematics.inverse(command)
        except AssemblyError as error:
            command = np.delete(command, error.indices, axis=0)


def travel_position(state: State) -> Array:
    """Where each joint (m, nq) is in the travel that the session has of it, from -1 to
    1.

    Curves over the whole travel would tell nothing of what bends within a part of it.
    Errors that bend within less than a part of PART are smooth in what is read.
    """
    known = travel(state.machine)
    low, high = state.joint_range
    half = 0.5 * np.maximum(high - low, MIN_TRAVEL_SHARE * (known.high - known.low))
    return np.asarray((state.joints - 0.5 * (low + high)) / half)


def travel_curve(position: Array, number: int) -> Array:
    """One of the CURVES of a smooth error along a travel, at places in it from -1 to 1:
    without mean and slope, for a joint's zero and scale are other effects.
    """
    return curve_mode(
        position,
        number,
        correlation_length=CORRELATION_LENGTH,
        count=N_CURVES,
        detrend=2,
    )


def joint_per_metre(state: State) -> Array:
    """What a metre of strut is worth in each joint (m, nq); 1 where it is a length."""
    turning = np.array([c.unit == "rad" for c in state.machine.joints])
    worth = np.where(
        np.isfinite(state.joint_per_length),
        np.abs(state.joint_per_length),
        1.0 / state.machine.lever,
    )
    return np.where(turning, worth, 1.0)


def rate_share(state: State) -> Array:
    """Rate of each joint (m, nq) over that of the largest feed; 0 if unknown."""
    if state.max_feed <= 0.0:
        return np.zeros(state.joints.shape)
    return np.nan_to_num(state.rate) / (state.max_feed * joint_per_metre(state))


def payload_share(state: State) -> Array:
    """Payload (m,) as a share of the session's heaviest; zeros where there is none."""
    return (
        np.nan_to_num(state.payload) / state.max_payload
        if state.max_payload > 0.0
        else np.zeros(len(state))
    )


def joint_load(state: State, ratio: float) -> tuple[Array, Array]:
    """Load (m, nq) per newton that moves, and the payload's; ratio: `RATIOS`."""
    extra = state.tool_force * (payload_share(state) / ratio)[:, None]
    return state.platform_force + extra, extra


def joint_change(state: State, shift: Array) -> Array:
    """Joint changes (m, nq) worth shifts (m, nq, 3) of base ends, m: first order."""
    return np.asarray(
        state.joint_per_length * np.einsum("mjk,mjk->mj", state.strut_direction, shift)
    )


def radial_directions(state: State) -> Array:
    """Horizontal unit vectors (m, nq, 3) from mid base to each end; x at the middle."""
    away = state.base - state.base.mean(axis=1, keepdims=True)
    away[..., 2] = 0.0
    length = np.linalg.norm(away, axis=-1, keepdims=True)
    middle = length < 1e-3 * state.machine.lever
    return np.where(
        middle, np.array([1.0, 0.0, 0.0]), away / np.where(middle, 1.0, length)
    )


def lacks_struts(machine: Machine) -> str | None:
    """Why an effect that acts on struts cannot be computed; None where it can."""
    return (
        None
        if machine.struts is not None
        else "it does not tell its struts: give Machine.struts"
    )


def lacks_cables(machine: Machine) -> str | None:
    """Why an effect of cables cannot occur; None where it can."""
    return "it has no cables" if machine.cable_stiffness is None else None


def lacks_jointed_struts(machine: Machine) -> str | None:
    """Why no joint at a strut's end can err; None where one can."""
    if machine.cable_stiffness is not None:
        return "its struts are cables, which end in no joints"
    return lacks_struts(machine)


def has_rotary_drives(machine: Machine) -> str | None:
    """Why an effect of linear drives cannot occur; None where it can."""
    return (
        "its joints turn: it has no linear drives"
        if any(c.unit == "rad" for c in machine.joints)
        else None
    )


def fill_gaps(values: Array) -> Array:
    """Values with gaps closed from their neighbours; zeros where nothing is known."""
    is_finite = np.isfinite(values)
    if not is_finite.any():
        return np.zeros(len(values))
    return np.interp(
        np.arange(len(values)), np.flatnonzero(is_finite), values[is_finite]
    )


def session_time(state: State) -> Array:
    """Time (m,) since the session's first reading, s; zeros where no time is known."""
    return fill_gaps(state.time - state.session_span[0])


def session_share(state: State) -> Array:
    """Time (m,) as a share of the session, 0 to 1."""
    length = state.session_span[1] - state.session_span[0]
    return session_time(state) / length if length > 0.0 else np.zeros(len(state))


#: smooth courses over the session that what warms or creeps may take besides the
#: textbook's
N_COURSES = 4
COURSE_LENGTH = 0.5  #: correlation length of these courses, over half a session


def free_courses(state: State) -> dict[str, Array]:
    """Smooth courses (m,) over the session by name, 0 at its start.

    The cause is the body that warms or the mount that creeps, whatever its course: a
    shop's day, a door that opens, a spindle that is switched on and off.
    """
    position = np.append(2.0 * session_share(state) - 1.0, -1.0)
    courses = {}
    for k in range(N_COURSES):
        mode = curve_mode(
            position, k, correlation_length=COURSE_LENGTH, count=N_COURSES
        )
        courses[f"course {k + 1}"] = mode[:-1] - mode[-1]
    return courses


MIN_PAUSE = 60.0  #: shortest gap, s, that is more than the way to the next pose
BREAK_RATIO = 2.5  #: shortest break, over the median of such gaps


def warm_up(state: State, body: str, tau: float) -> tuple[bool, Array, Array]:
    """How warm a body is at each pose (m,): (whether it was measured, as in the
    textbook, what may come to it).

    Measured, K above the session's start: and how far a body that follows with time
    constant tau (s) lags behind. Not measured, as a share of the final rise: it warms
    with tau while readings are taken and cools in breaks, 1 - exp(-t / tau) where there
    are none; and a faster part, with tau / 4.
    """
    kelvin = state.temperature.get(body, np.full(len(state), np.nan))
    time = session_time(state)
    if np.isfinite(kelvin).any():
        start = state.start_temperature.get(body, kelvin[np.isfinite(kelvin)][0])
        rise = fill_gaps(kelvin - start)
        return True, rise, _lag(rise, time, tau) - rise
    return False, _worked(state, tau), _worked(state, tau / 4.0)


def _worked(state: State, tau: float) -> Array:
    """Share (m,) of final temperature: T' = (u - T) / tau, u = 1 at work."""
    session = state.session_times
    if not session.size:
        return np.zeros(len(state))
    gaps = np.diff(session)
    between = gaps[gaps > MIN_PAUSE]
    idle = gaps > max(
        BREAK_RATIO * float(np.median(between)) if between.size else np.inf, MIN_PAUSE
    )
    decay = np.exp(-gaps / tau)
    share = np.zeros(len(session))
    for k, (still, factor) in enumerate(zip(idle, decay, strict=True)):
        share[k + 1] = share[k] * factor + (0.0 if still else 1.0 - factor)
    return np.interp(
        np.where(np.isfinite(state.time), state.time, session[0]), session, share
    )


def _lag(value: Array, time: Array, tau: float) -> Array:
    """First-order lag of a value, straight between times and settled at the first."""
    order = np.argsort(time, kind="stable")
    behind = np.empty(len(value))
    last = float(value[order[0]])
    for k, (before, now) in enumerate(
        zip(np.concatenate([order[:1], order[:-1]]), order, strict=True)
    ):
        step = time[now] - time[before] if k else 0.0
        if step > 0.0:
            slope = (value[now] - value[before]) / step
            keep = np.exp(-step / tau)
            last = (
                value[now] - slope * tau + (last - value[before] + slope * tau) * keep
            )
        behind[now] = last
    return behind


# -- columns ---------------------------------------------------------------------------
def adapting(name: str, size: float, label: str, joints: Mapping[int, Array]) -> Column:
    """A column that only lets the form adapt; `size` is the textbook's."""
    return Column(name, SHAPE_SHARE * size, label, joints, shape=True)


def all_joints(change: Array) -> dict[int, Array]:
    """Changes (m, nq) of all joints, as a column has them."""
    return {i: change[:, i] for i in range(change.shape[1])}


def alike(name: str, size: float, change: Array) -> Iterator[Column]:
    """One coefficient of changes (m, nq) for all joints; shape: one each."""
    yield Column(name, size, "", all_joints(change))
    for i in range(change.shape[1]):
        leg = f"leg {i + 1}"
        yield adapting(leg, size, leg, {i: change[:, i]})


def by_leg(
    size: float, change: Array, shapes: Mapping[str, Array] | None = None
) -> Iterator[Column]:
    """One coefficient a leg of changes (m, nq); shape: others by name."""
    for i in range(change.shape[1]):
        leg = f"leg {i + 1}"
        yield Column(leg, size, leg, {i: change[:, i]})
        for name, form in (shapes or {}).items():
            yield adapting(f"{leg} {name}", size, leg, {i: form[:, i]})


def harmonics(state: State, period: float, size: float) -> Iterator[Column]:
    """Sine and cosine of each joint's place in a period a leg; shape: two in a period."""
    return turns(2.0 * np.pi * state.joints / period, np.ones(state.joints.shape), size)


def turns(angle: Array, worth: Array, size: float) -> Iterator[Column]:
    """Sine, cosine of an angle (m, nq) by `worth` (m, nq); shape: twice it."""
    for i in range(angle.shape[1]):
        leg = f"leg {i + 1}"
        for k, column in ((1, Column), (2, adapting)):
            for name, wave in (("sin", np.sin), ("cos", np.cos)):
                change = {i: worth[:, i] * wave(k * angle[:, i])}
                yield column(f"{leg} {name} {k}", size, leg, change)
