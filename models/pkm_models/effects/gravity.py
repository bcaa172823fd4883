"""Gravity on compliant legs: a leg gives by its load (J^-T w)_i times c0 + c1 l_i. Legs
of 50 N/um give 20 um a kN.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

COMPLIANCE = 20e-6  # m, of a joint that carries the whole weight


def columns(state: State, ratio: float) -> Iterable[Column]:
    """Drives (c0) and struts (c1), alike in all legs; shape: more along the travel,
    less where the load is large, legs that differ, weights that act elsewhere.
    """
    load, extra = terms.joint_load(state, ratio)
    square = terms.joint_per_metre(state) ** 2
    position = terms.travel_position(state)
    drive = load * square
    strut = (
        load
        * state.joint_per_length**2
        * state.strut_length
        / terms.travel(state.machine).strut
    )
    size = np.abs(drive) + 1e-9
    forms = {
        "travel": drive * position,
        "bending": drive * position**2,
        "hardening": -drive * np.log(size / size.mean()),
        "payload": extra * square,
        "place": (state.tool_force - state.platform_force) * square,
    }
    yield Column("drives", COMPLIANCE, "", terms.all_joints(drive))
    yield Column("struts", COMPLIANCE, "", terms.all_joints(strut))
    for name, form in forms.items():
        yield terms.adapting(name, COMPLIANCE, "", terms.all_joints(form))
    for i in state.limbs:
        leg = f"leg {i + 1}"
        yield terms.adapting(leg, COMPLIANCE, leg, {i: drive[:, i]})


effect = Effect(
    name="gravity",
    source=(
        "Merlet 2006, Parallel Robots (stiffness): dl = k^-1 J^-T w; legs of machine"
        " tools have 20 to 100 N/um"
    ),
    about="legs that give under the weight of platform and payload",
    columns=columns,
    constants={"ratio": terms.MASS_RATIOS},
    remedy=(
        "stiffen or counterbalance, or compensate with a stiffness model and the payload of the job"
    ),
    nature=natures.LOAD,
    exposed_by="the same circle with and without a payload",
    unfit=terms.lacks_struts,
)
