"""Sensors on passive joints, and passive joints that are locked.

With theta_k(x, q, p) the angle or length of passive joint k as the machine states it, a
sensor on it reads

    y_k = zero_k + (1 + scale_k) (theta_k - theta_k at home, as drawn) + theta_k at home,

with the zero and the scale of the sensor as unknowns of the set-up: self-calibration
(Yang et al. 2002, Robotica 20, 367-374). `channels` names the joints that have one.

`locked_joint` keeps one passive joint as it is while the others move, constrained
calibration: its value is `at`, stated as near as it is known, and an unknown `rest`,

    y_k = theta_k - at_k - rest_k = 0,

the same at all poses of the set-up. A joint that is locked again elsewhere is another
set-up. The measurement is the joints recorded while the lock holds; files need no
column for y. A driven joint that is locked reads its own scale alone, which tells
nothing of the geometry.

Noise, one standard deviation: 5 urad for an encoder ring of one arcsecond, 1 um for a
linear scale; a lock repeats to 20 urad or 5 um, its play and its yielding.
"""

from collections.abc import Mapping, Sequence

from oed.instrument import Channel, Cost, Frame, Instrument, Setting
from oed.model import Expr, Machine, Parameter, PassiveJoint, Values

SOURCE = (
    "Rugbani and Schreve, The use of parallel mechanism micro-CMM in micrometrology,"
    " section VI: constrained calibration and self-calibration"
)
SENSOR_SIGMA = {"rad": 5e-6, "m": 1e-6}  #: noise of a sensor, by unit
ZERO_TOLERANCE = {"rad": 10e-3, "m": 1e-3}  #: tolerance of a sensor's zero, by unit
LOCK_PLAY = {"rad": 20e-6, "m": 5e-6}  #: play of a lock, by unit
REST_TOLERANCE = {"rad": 10e-3, "m": 1e-3}  #: tolerance of where a lock rests, by unit
SINE_SCALE = 1e-3
#: the joint that the catalogue shows; a machine has its own
EXAMPLE = PassiveJoint("swing1", "rad", 0.0, "a passive joint, as the machine names it")


def _unfit(machine: Machine, names: Sequence[str]) -> str | None:
    available = [joint.name for joint in machine.passive_joints()]
    if not available:
        return "it names no passive joints"
    absent = [name for name in names if name not in available]
    return f"it has no passive joint {absent[0]}, but {available}" if absent else None


def _sensors(joints: Sequence[PassiveJoint], home: Mapping[str, float]) -> Instrument:
    """The sensors on some passive joints, with their values at home."""

    def observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
        readings = []
        for joint in joints:
            value = frames[0].passive[joint.name]
            scale = s.get(f"scale_{joint.name}", 0.0)
            zero = s.get(f"zero_{joint.name}", 0.0)
            readings.append(value + zero + scale * (value - home[joint.name]))
        return readings

    names = [joint.name for joint in joints]
    return Instrument(
        name="passive_joint",
        source=SOURCE,
        about="sensors on passive joints, their zeros and scales unknown",
        channels=tuple(
            Channel(
                j.name,
                j.unit,
                SENSOR_SIGMA[j.unit],
                about=j.about,
                alone=(f"zero_{j.name}", f"scale_{j.name}"),
            )
            for j in joints
        ),
        settings=(),
        nuisances=tuple(u for j in joints for u in _sensor_unknowns(j)),
        cost=Cost(setup=60.0, reading=2.0),
        observe=observe,
        unfit=lambda machine: _unfit(machine, names),
        adapt=_sensors_of,
    )


def _sensor_unknowns(joint: PassiveJoint) -> tuple[Parameter, Parameter]:
    name, unit = joint.name, joint.unit
    return (
        Parameter(
            f"zero_{name}",
            0.0,
            ZERO_TOLERANCE[unit],
            unit,
            f"zero of the sensor {name}",
        ),
        Parameter(f"scale_{name}", 0.0, SINE_SCALE, "1", f"scale of the sensor {name}"),
    )


def _sensors_of(machine: Machine) -> Instrument:
    joints = machine.passive_joints()
    return _sensors(joints, machine.passive_at_home()) if joints else instrument


def _lock(joints: Sequence[PassiveJoint], home: Mapping[str, float]) -> Instrument:
    """The lock of one of some passive joints, with their values at home."""

    def observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
        readings = []
        for joint in joints:
            rest = s.get(f"rest_{joint.name}", 0.0)
            locked_value = k.get(f"at_{joint.name}", 0.0)
            readings.append(frames[0].passive[joint.name] - locked_value - rest)
        return readings

    names = [joint.name for joint in joints]
    return Instrument(
        name="locked_joint",
        source=SOURCE,
        about="a passive joint locked while the others move: its value stays the same",
        channels=tuple(
            Channel(
                f"off_{j.name}",
                j.unit,
                LOCK_PLAY[j.unit],
                about=f"{j.about}, less its value where it is locked; 0 while it holds",
                alone=(f"at_{j.name}", f"rest_{j.name}"),
            )
            for j in joints
        ),
        settings=tuple(
            Setting(
                f"at_{j.name}", j.unit, home[j.name], f"where {j.name} is locked, about"
            )
            for j in joints
        ),
        nuisances=tuple(
            Parameter(
                f"rest_{j.name}",
                0.0,
                REST_TOLERANCE[j.unit],
                j.unit,
                f"where {j.name} is locked, less the stated value",
            )
            for j in joints
        ),
        cost=Cost(setup=300.0, reading=10.0),
        observe=observe,
        fixed_reading=lambda k: 0.0,
        implied=0.0,
        single=True,
        unfit=lambda machine: _unfit(machine, names),
        adapt=_lock_of,
    )


def _lock_of(machine: Machine) -> Instrument:
    joints = machine.passive_joints()
    return _lock(joints, machine.passive_at_home()) if joints else locked


instrument = _sensors([EXAMPLE], {EXAMPLE.name: 0.0})
locked = _lock([EXAMPLE], {EXAMPLE.name: 0.0})
