"""Scale error of an encoder or a screw: each joint goes s_i (q_i - m_i) too far. 10 ppm
of a glass scale, 50 ppm of a screw.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

SCALE = 50e-6


def columns(state: State) -> Iterable[Column]:
    """s_i (q_i - m_i), one coefficient a joint, with m_i the middle of its travel.

    Where q is counted from is the joint's zero, which is geometry: its tolerance is that
    of a zero within the travel, so that no scale error may move it from further away.
    """
    return terms.by_leg(SCALE, state.joints - state.joint_range.mean(axis=0))


effect = Effect(
    name="encoder_scale",
    source="ISO 230-2 and -3; catalogues of linear encoders and ball screws",
    about="scale error of each joint's encoder or screw",
    columns=columns,
    units={"*": "1"},
    remedy=(
        "measure each joint's scale with a laser interferometer and correct it in the controller"
    ),
    check="the joint's conversion factor: lead, gear ratio, counts a turn",
    nature=natures.SCALE,
    family=natures.ALONG_TRAVEL,
    exposed_by="a laser interferometer along a joint, or a second known tool length",
    common_to_limbs=True,
)
