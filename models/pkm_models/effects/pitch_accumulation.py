"""Accumulated pitch error of a screw: a smooth curve over the joint's travel.

ISO 3408-3 allows travel to deviate by 12 (class 3) to 23 um (class 5) over 300 mm, most
of it at long wavelengths: a slope of the mean travel, and a curve about it. A slope
alone is a scale.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from oed.model import Machine
from pkm_models.effects import natures, terms

CURVE = 10e-6  # m, standard deviation along the travel


def columns(state: State) -> Iterable[Column]:
    """Modes of a smooth random curve over the travel a leg; those after the first two,
    and a slope, let the form adapt.
    """
    unit, position = terms.joint_per_metre(state), terms.travel_position(state)
    for i in state.limbs:
        for k in range(terms.N_CURVES):
            change = {i: unit[:, i] * terms.travel_curve(position[:, i], k)}
            yield Column(
                f"leg {i + 1} curve {k + 1}", CURVE, f"leg {i + 1}", change, shape=k > 1
            )
        slope = {i: unit[:, i] * position[:, i]}
        yield Column(f"leg {i + 1} slope", CURVE, f"leg {i + 1}", slope, shape=True)


def unfit(machine: Machine) -> str | None:
    """Only screws, belts and scales have a pitch that adds up."""
    if machine.cable_stiffness is not None and machine.drive != "belt":
        return "its struts are cables: they have no pitch"
    return terms.has_rotary_drives(machine)


effect = Effect(
    name="pitch_accumulation",
    source="ISO 3408-3 (travel deviation of ball screws), classes 3 and 5",
    about="accumulated pitch error of each screw along its travel",
    columns=columns,
    remedy=(
        "measure each joint's travel with a laser interferometer and fill in the"
        " controller's pitch table"
    ),
    nature=natures.TRAVEL,
    family=natures.ALONG_TRAVEL,
    exposed_by="readings over the full stroke of each joint",
    textbook_share=0.1,
    unfit=unfit,
)
