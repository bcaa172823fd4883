"""Clearance of the joints: a strut is delta / 2 longer under tension, and shorter under pressure, than it is adjusted.

Fitted ball joints have 5 to 20 um. While no leg's load changes its sign this is the leg's zero, and is not seen.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.effect import Column, Effect, State
from pkm_models.effects import terms

PLAY, SOFT = 10e-6, 0.1  # m; share of the load within which a joint is not yet at its stop


def columns(state: State, weight: float) -> Iterable[Column]:
    """delta sgn(leg force) / 2 a leg; shape: a change of sides that takes some load."""
    load = 1.0 + np.nan_to_num(state.payload) / weight
    pull = state.force * state.per_length * load[:, None]
    half = 0.5 * state.per_length
    for i in state.limbs:
        leg, side = f"leg {i + 1}", np.sign(pull[:, i])
        yield Column(leg, PLAY, leg, {i: half[:, i] * side})
        soft = np.tanh(pull[:, i] / SOFT) - side
        yield Column(f"{leg} soft", terms.ADAPT * PLAY, leg, {i: half[:, i] * soft}, shape=True)


effect = Effect(
    name="joint_clearance",
    source="catalogues of rod ends and spherical joints: internal clearance 5 to 20 um",
    about="play of the joints at a leg's ends, taken up by the sign of its load",
    columns=columns,
    constants={"weight": terms.WEIGHTS},
    remedy="preload or renew the joints of the leg",
    exposed_by="pull and push at the platform, at poses where a leg's load changes its sign",
    unfit=terms.no_struts,
)
