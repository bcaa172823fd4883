"""Scale error of an encoder or a screw: each joint goes s_i q_i too far. 10 ppm of a
glass scale, 50 ppm of a screw.
"""

from __future__ import annotations

from collections.abc import Iterable

from oed.effect import Column, Effect, State
from pkm_models.effects import natures

SCALE = 50e-6


def columns(state: State) -> Iterable[Column]:
    """s_i q_i, one coefficient a joint; where q is counted from is the joint's zero,
    which is geometry.
    """
    for i in state.limbs:
        yield Column(f"leg {i + 1}", SCALE, f"leg {i + 1}", {i: state.joints[:, i]})


effect = Effect(
    name="encoder_scale",
    source="ISO 230-2 and -3; catalogues of linear encoders and ball screws",
    about="scale error of each joint's encoder or screw",
    columns=columns,
    units={"*": "1"},
    remedy=(
        "measure each joint's scale with a laser interferometer and correct it in the"
        " controller"
    ),
    nature=natures.SCALE,
    exposed_by="a laser interferometer along a joint, or a second known tool length",
    common_to_limbs=True,
)
