"""Effects by name, and which of them each machine can have."""

from __future__ import annotations

from collections.abc import Callable

from numpy.random import Generator

from benchmarks.blind.generator.effects import (
    length,
    load,
    motion,
    mount,
    thermal,
    unknown,
)
from benchmarks.blind.generator.effects.base import Effect as Effect
from benchmarks.blind.generator.effects.base import Stage as Stage

Form = Callable[[Generator, Stage], Effect]

KNOWN: dict[str, Form] = {
    "leg_thermal": thermal.leg_thermal,
    "frame_thermal": thermal.frame_thermal,
    "gravity": load.gravity,
    "frame_bending": load.frame_bending,
    "backlash": motion.backlash,
    "friction": motion.friction,
    "servo_lag": motion.servo_lag,
    "encoder_scale": length.encoder_scale,
    "pitch_accumulation": length.pitch_accumulation,
    "screw_cyclic": length.screw_cyclic,
    "encoder_subdivision": length.encoder_subdivision,
    "guideway": load.guideway,
    "joint_runout": length.joint_runout,
    "joint_clearance": motion.joint_clearance,
    "bar_length": mount.bar_length,
    "bar_thermal": thermal.bar_thermal,
    "mount_drift": mount.mount_drift,
    "step": mount.step,
}
UNKNOWN: dict[str, Form] = {
    name: getattr(unknown, name)
    for name in (
        "cross_talk",
        "feed_resonance",
        "spindle_growth",
        "humidity_wave",
        "cable_drag",
        "platform_torsion",
        "interference",
        "table_sag",
        "wrong_table",
        "pump",
        "run_in",
        "stick",
    )
}
#: the exact class: one bar and one tool cannot tell these two
EXACT: dict[str, Form] = {
    "encoder_scale": length.common_scale,
    "bar_length": mount.bar_length,
}

_BARS = ("bar_length", "bar_thermal")
#: sliders have guideways, bars need a ball bar, gaps need a pull; relative readings of
#: a minute see no mount creep
_ABSENT = {
    "a3": ("guideway",),
    "hexapod": ("guideway",),
    "hexaglide": (),
    "planar": (*_BARS, "joint_clearance", "mount_drift", "spindle_growth"),
    "delta": (*_BARS, "joint_clearance"),
}


def known_on(machine: str) -> tuple[str, ...]:
    """Known effects that a machine can have."""
    return tuple(n for n in KNOWN if n not in _ABSENT[machine])


def unknown_on(machine: str) -> tuple[str, ...]:
    """Unknown effects that a machine can have."""
    return tuple(n for n in UNKNOWN if n not in _ABSENT[machine])
