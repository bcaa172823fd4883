"""Servo lag: a joint is rate / Kv behind. Kv is 16 to 50 / s; what feed-forward leaves,
or legs differ by, is 1 ms.
"""

from collections.abc import Iterable

import numpy as np

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

DELAY = 1e-3  #: expected delay, s
SECOND_ORDER = 3e-4  #: expected coefficient of the acceleration, s^2


def columns(state: State) -> Iterable[Column]:
    """-T rate a leg; shape: acceleration, and a delay that grows with the rate, as a
    share of the session's largest feed.
    """
    rate, faster = np.nan_to_num(state.rate), np.nan_to_num(state.acceleration)
    bent = rate * np.abs(terms.rate_share(state))
    for i in state.limbs:
        leg = f"leg {i + 1}"
        yield Column(leg, DELAY, leg, {i: -rate[:, i]})
        change = {i: -faster[:, i]}
        yield terms.adapting(f"{leg} acceleration", SECOND_ORDER, leg, change)
        yield terms.adapting(f"{leg} feed", DELAY, leg, {i: -bent[:, i]})


effect = Effect(
    name="servo_lag",
    source="ISO 230-4 (circular tests); Altintas et al. 2011, CIRP Annals 60: Kv 16 to 50 / s",
    about="legs that follow their commands with different delays",
    columns=columns,
    units={"*acceleration": "s2", "*": "s"},
    needs=("feed",),
    remedy=(
        "match the position loop gains of the legs, or tune the velocity feed-forward"
    ),
    nature=natures.MOTION,
    exposed_by="the same circle at two feeds, in both directions",
    common_to_limbs=True,
)
