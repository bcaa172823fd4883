"""Posts that lean: the guide of a cable gives by c times the cable's horizontal force.

A steel tube of 60 mm and 2 m gives some 5 um/N at its top; a stiff frame a tenth of it.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

COMPLIANCE = 1e-6  # m/N


def columns(state: State) -> Iterable[Column]:
    """c T_i along the horizontal part of each cable, towards the platform, of one c;
    shape: posts that differ.
    """
    horizontal = state.strut_direction * np.array([1.0, 1.0, 0.0])
    shift = np.nan_to_num(state.tension)[..., None] * horizontal
    change = terms.joint_change(state, shift)
    return terms.alike("posts", COMPLIANCE, change)


effect = Effect(
    name="post_compliance",
    source="Euler and Bernoulli's beam: F h^3 / (3 E I) at the top of a clamped post",
    about="posts or frames that lean under the force of their cables",
    columns=columns,
    needs=("tension",),
    units={"*": "m/N"},
    remedy="brace the posts, or read the anchors again under load",
    nature=natures.LOAD,
    exposed_by="the same poses at two pretensions, with the tensions recorded",
    unfit=terms.lacks_cables,
    common_to_limbs=True,
)
