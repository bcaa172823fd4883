"""A frame that warms up: base ends move away from their middle by alpha b_i dT(t). A
shop varies by 1 to 3 K a day.
"""

from collections.abc import Iterable

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

TEMPERATURE_RISE = 2.0  # K


def columns(state: State, tau: float) -> Iterable[Column]:
    """Even radial growth; shape: a second time constant, any smooth course where no
    temperature is recorded, growth in height, one side warmer than the other.
    """
    measured, warm, second = terms.warm_up(state, "frame", tau)
    unit, scale, strain = (
        ("per kelvin", terms.STEEL_EXPANSION, 1.0)
        if measured
        else ("rise", TEMPERATURE_RISE, terms.STEEL_EXPANSION)
    )
    away = state.base - state.base.mean(axis=1, keepdims=True)
    flat = away * np.array([1.0, 1.0, 0.0])
    size = float(np.linalg.norm(flat, axis=-1).mean()) or 1.0
    height = (state.machine.lever + away[..., 2:]) * np.array([0.0, 0.0, 1.0])
    even, up = (strain * terms.joint_change(state, shift) for shift in (flat, height))
    yield Column(unit, scale, "", _joints(even, warm))
    courses = {"second": second} | ({} if measured else terms.free_courses(state))
    for name, course in courses.items():
        yield terms.adapting(f"{unit} {name}", scale, "", _joints(even, course))
    yield terms.adapting(f"{unit} height", scale, "", _joints(up, warm))
    for k, axis in enumerate("xy"):
        side = strain * terms.joint_change(state, flat * flat[..., k : k + 1] / size)
        yield terms.adapting(f"{unit} side {axis}", scale, "", _joints(side, warm))


def _joints(change: Array, factor: Array) -> dict[int, Array]:
    return terms.all_joints(change * factor[:, None])


effect = Effect(
    name="frame_thermal",
    source="ISO 230-3 (environmental temperature variation error); steel 11.5e-6 / K",
    about="a frame that grows with its temperature, moving the base joints apart",
    columns=columns,
    units={"*per kelvin*": "1/K", "*": "K"},
    needs=("time or temp_frame",),
    constants={"tau": terms.TIME_CONSTANTS},
    remedy=(
        "hold the shop's temperature, shield the frame from draught and sun, or"
        " compensate by a sensor on the frame"
    ),
    nature=natures.SESSION,
    exposed_by="cups far apart and large tilts, repeated in the course of hours",
    unfit=terms.lacks_struts,
)
