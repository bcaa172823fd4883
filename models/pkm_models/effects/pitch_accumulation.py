"""Accumulated pitch error of a screw: a smooth curve over the joint's travel, beyond its scale.

ISO 3408-3 allows travel to deviate by 12 (class 3) to 23 um (class 5) over 300 mm, most of it at long wavelengths.
"""

from __future__ import annotations

from collections.abc import Iterable

from oed.effect import Column, Effect, State
from pkm_models.effects import terms

#: standard deviations (m) of Legendre polynomials over the travel: accumulated errors fall with the degree
CURVE = {2: 10e-6, 3: 7e-6, 4: 5e-6, 5: 4e-6, 6: 3.3e-6, 7: 2.9e-6, 8: 2.5e-6, 9: 2.2e-6, 10: 2e-6}


def columns(state: State) -> Iterable[Column]:
    """A polynomial over the travel a leg; degrees from 4 let the form adapt."""
    unit, at = terms.metre(state), terms.place(state)
    for i in state.limbs:
        for degree, scale in CURVE.items():
            change = unit[:, i] * terms.wave(at[:, i], degree)
            yield Column(f"leg {i + 1} P{degree}", scale, f"leg {i + 1}", {i: change}, shape=degree > 3)


effect = Effect(
    name="pitch_accumulation",
    source="ISO 3408-3 (travel deviation of ball screws), classes 3 and 5",
    about="accumulated pitch error of each screw along its travel",
    columns=columns,
    remedy="measure each joint's travel with a laser interferometer and fill in the controller's pitch table",
    exposed_by="readings over the full stroke of each joint",
)
