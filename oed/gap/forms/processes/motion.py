"""Processes with the joints' motion: its sign, its reversals, another joint's motion."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed.effect import Column, State
from oed.gap.forms.processes.base import (
    UNIT,
    cosines,
    in_own_travel,
    on_joint,
    share_of_span,
)

#: shares of a joint's travel over which the effect of a reversal fades
SINCE = (0.002, 0.01)
#: how many legs on the other joint is
SHIFTS = range(1, 6)


def of_another(state: State, shift: float) -> Iterable[Column]:
    """An error of each joint with the motion of another, over its own travel."""
    count = len(state.limbs)
    if shift >= count:
        return
    rate = np.where(np.isfinite(state.rate), state.rate, state.motion_sign)
    fastest = np.abs(rate).max(axis=0)
    rate = rate / np.maximum(fastest, 1e-12)
    for i in state.limbs:
        other = rate[:, (i + int(shift)) % count]
        at = in_own_travel(state.joints[:, i])
        yield on_joint(i, "rate", UNIT, other)
        yield on_joint(i, "speed", UNIT, np.abs(other))
        yield on_joint(i, "rate travel", UNIT, other * at)


def over_sense(state: State) -> Iterable[Column]:
    """An error of each joint with the sign of its motion.

    It varies over the joint's travel, and with the distance since it last turned back.
    """
    ones = np.ones(len(state))
    for i in state.limbs:
        q, sense = state.joints[:, i], state.motion_sign[:, i]
        share = share_of_span(q, float(q.min()), float(q.max()))
        distance = state.travel_since_reversal[:, i] / max(float(np.ptp(q)), 1e-12)
        for k, since in enumerate(SINCE, start=1):
            change = sense * np.exp(-distance / since)
            yield on_joint(i, f"turned {k}", UNIT, change)
        for k, wave in enumerate([ones, *cosines(share, 3)]):
            yield on_joint(i, f"sense {k}", UNIT / (1.0 + k / 2.0), sense * wave)
