"""Gravity on compliant legs: a leg gives by its load (J^-T w)_i times c0 + c1 l_i. Legs
of 50 N/um give 20 um a kN.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.base.arrays import Array
from oed.model.effect import Column, Effect, State
from pkm_models.effects import natures, terms

GIVES = 20e-6  # m, of a joint that carries the whole weight


def columns(state: State, ratio: float) -> Iterable[Column]:
    """Drives (c0) and struts (c1), alike in all legs; shape: more along the travel,
    less where the load is large, legs that differ, weights that act elsewhere.
    """
    (load, extra), square, at = (
        terms.joint_load(state, ratio),
        terms.joint_per_metre(state) ** 2,
        terms.travel_position(state),
    )
    drive = load * square
    strut = (
        load
        * state.joint_per_length**2
        * state.strut_length
        / terms.travel(state.machine).strut
    )
    size = np.abs(drive) + 1e-9
    small = terms.SHAPE_SHARE * GIVES
    yield Column("drives", GIVES, "", _all(drive))
    yield Column("struts", GIVES, "", _all(strut))
    yield Column("travel", small, "", _all(drive * at), shape=True)
    yield Column("bending", small, "", _all(drive * at**2), shape=True)
    yield Column(
        "hardening", small, "", _all(-drive * np.log(size / size.mean())), shape=True
    )
    yield Column("payload", small, "", _all(extra * square), shape=True)
    yield Column(
        "place",
        small,
        "",
        _all((state.tool_force - state.platform_force) * square),
        shape=True,
    )
    for i in state.limbs:
        yield Column(
            f"leg {i + 1}", small, f"leg {i + 1}", {i: drive[:, i]}, shape=True
        )


def _all(change: Array) -> dict[int, Array]:
    return {i: change[:, i] for i in range(change.shape[1])}


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
        "stiffen or counterbalance, or compensate with a stiffness model and the"
        " payload of the job"
    ),
    nature=natures.LOAD,
    exposed_by="the same circle with and without a payload",
    unfit=terms.lacks_struts,
)
