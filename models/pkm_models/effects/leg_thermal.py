"""Legs that warm up: strut i grows by alpha l_i dT_i(t). A driven screw warms by 2 to
10 K within hours (ISO 230-3).
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

TEMPERATURE_RISE = 3.0  # K


def columns(state: State, tau: float) -> Iterable[Column]:
    """Growth a leg of what is driven: the strut, or the screw of a carriage; shape: a
    second time constant, any smooth course where no temperature is recorded, a bearing
    that is elsewhere, and the struts that a carriage moves.
    """
    travel, courses = terms.travel(state.machine), terms.free_courses(state)
    for i in state.limbs:
        leg, sensor = f"leg {i + 1}", f"leg{i + 1}"
        on_carriage = (
            bool(travel.guide[i].any()) and state.machine.joints[i].unit == "m"
        )
        measured, warm, second = terms.warm_up(
            state, sensor if sensor in state.temperature else "leg", tau
        )
        unit, scale, strain = (
            ("per kelvin", terms.STEEL_EXPANSION, 1.0)
            if measured
            else ("rise", TEMPERATURE_RISE, terms.STEEL_EXPANSION)
        )
        strut, stays = (
            state.joint_per_length[:, i] * length
            for length in (state.strut_length[:, i], travel.strut[i])
        )
        long, fixed = (
            (state.joints[:, i], travel.high[i] - travel.low[i])
            if on_carriage
            else (strut, stays)
        )
        yield Column(f"{leg} {unit}", scale, leg, {i: strain * long * warm})
        shapes = {"second": long * second, "bearing": fixed * warm} | (
            {"strut": strut * warm} if on_carriage else {}
        )
        if not measured:
            shapes |= {name: long * course for name, course in courses.items()}
        for name, form in shapes.items():
            label = f"{leg} {unit} {name}"
            yield terms.adapting(label, scale, leg, {i: strain * form})


effect = Effect(
    name="leg_thermal",
    source="ISO 230-3 (thermal effects); steel 11.5e-6 / K",
    about="legs that grow with their temperature",
    columns=columns,
    units={"*per kelvin*": "1/K", "*": "K"},
    needs=("time or temp_leg or temp_leg1",),
    constants={"tau": terms.TIME_CONSTANTS},
    remedy=(
        "let the legs warm up before use, cool the screws, or compensate by a"
        " temperature sensor on each leg"
    ),
    nature=natures.SESSION,
    exposed_by="a reference circle repeated in the course of hours",
    unfit=terms.lacks_struts,
    common_to_limbs=True,
)
