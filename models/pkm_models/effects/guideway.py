"""Guideways that are not straight: a carriage is off its line by a smooth curve of its travel, 10 um/m and more.

Only what displaces the carriage along its strut is seen: d l = along . shift. A constant and a slope are geometry.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.effect import Column, Effect, State
from oed.machine import Machine
from pkm_models.effects import terms

#: standard deviations (m) of Legendre polynomials over the travel: bows fall fast with the degree, kinks slowly
CURVE = {2: 10e-6, 3: 7e-6, 4: 4e-6, 5: 3e-6, 6: 2.5e-6, 7: 2e-6, 8: 1.5e-6, 9: 1.3e-6, 10: 1.2e-6, 11: 1.1e-6}


def columns(state: State) -> Iterable[Column]:
    """Towards and from the middle (radial) and across, a leg; degrees above 3 let the form adapt."""
    guide, at = terms.travel(state.machine).guide, terms.place(state)
    out = terms.radial(state)
    out = out - np.einsum("mjk,jk->mj", out, guide)[..., None] * guide
    out /= np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-9)
    for name, direction in (("radial", out), ("across", np.cross(guide, out))):
        seen = terms.stretched(state, direction)
        for i in state.limbs:
            for degree, scale in CURVE.items():
                change = seen[:, i] * terms.wave(at[:, i], degree)
                yield Column(f"leg {i + 1} {name} P{degree}", scale, f"leg {i + 1}", {i: change}, shape=degree > 3)


def unfit(machine: Machine) -> str | None:
    """Only machines whose joints move carriages have guideways."""
    if machine.struts is None:
        return terms.no_struts(machine)
    return (
        None if terms.travel(machine).guide.any() else "no joint moves the base end of its strut: it has no carriages"
    )


effect = Effect(
    name="guideway",
    source="ISO 230-1 (straightness); catalogues of rail guides: 5 to 20 um over a metre",
    about="carriages whose guideways are not straight",
    columns=columns,
    remedy="align the rails, or measure their straightness and correct it in the controller",
    exposed_by="readings over the full stroke of each carriage",
    unfit=unfit,
)
