"""Runout of the joints: a centre that wanders as its joint turns, e_i times harmonics of the joint's angle.

Once a turn is a displaced centre, which is geometry; what is left is twice a turn. Ball joints are round to 1 to 5 um.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.batch import Array
from oed.effect import Column, Effect, State
from pkm_models.effects import terms

RUNOUT = 4e-6  # m


def columns(state: State) -> Iterable[Column]:
    """Twice a turn at the base joint and, where the platform turns, at the platform joint of each leg; shape: once and
    three times, as the joint swings in its leg's plane, and twice as it swings across."""
    out, up = terms.radial(state), np.array([0.0, 0.0, 1.0])
    ends = {"base": _swing(state, out)}
    if any(c.unit == "rad" for c in state.machine.pose) and len(state.limbs) > 2:
        ends["platform"] = _at_platform(state)
    waves = [
        (end + word, k, angle) for end, angle in ends.items() for word, k in (("", 2), (" once", 1), (" thrice", 3))
    ]
    for name, order, angle in [*waves, ("base across", 2, _swing(state, np.cross(up, out)))]:
        shape = name not in ends
        scale = terms.ADAPT * RUNOUT if shape else RUNOUT
        for i in state.limbs:
            for part, value in (("sin", np.sin(order * angle[:, i])), ("cos", np.cos(order * angle[:, i]))):
                change = {i: state.per_length[:, i] * value}
                yield Column(f"leg {i + 1} {name} {part}", scale, f"leg {i + 1}", change, shape=shape)


def _swing(state: State, way: Array) -> Array:
    """Angle (m, nq) of each strut to the vertical, towards `way` (m, nq, 3)."""
    return np.asarray(np.arctan2(np.einsum("mjk,mjk->mj", state.along, way), state.along[..., 2]))


def _at_platform(state: State) -> Array:
    """Angle (m, nq) of each strut to the platform's normal, in the plane through the platform's middle."""
    away = state.platform - state.platform.mean(axis=1, keepdims=True)
    away /= np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-12)
    normal = np.cross(away[:, 0], away[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    out = np.einsum("mjk,mjk->mj", state.along, away)
    return np.asarray(np.arctan2(out, np.einsum("mjk,mk->mj", state.along, normal)))


effect = Effect(
    name="joint_runout",
    source="ISO 230-7 (axes of rotation); catalogues of precision ball joints: sphericity 1 to 5 um",
    about="joint centres that wander as their joints turn",
    columns=columns,
    remedy="measure the joints' runout on a bench, and renew or map those that wander",
    exposed_by="large tilts in all directions",
    unfit=terms.no_struts,
)
