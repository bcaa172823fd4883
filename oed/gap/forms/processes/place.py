"""Processes over the workspace: the pose, the joints' travels, errors that come back."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from oed import smooth_basis
from oed.arrays import Array
from oed.effect import Column, State
from oed.gap.forms.processes.base import (
    UNIT,
    in_travel,
    known,
    on_joint,
    on_readings,
    powers_on_readings,
    relative_feed,
    relative_payload,
    scaled_pose,
)

#: share of half a joint's travel over which an error along it is correlated, and modes
#: of it
BENDS, CURVES = 0.5, 10
#: shares of half the joints' travels over which an error of the workspace is
#: correlated
PATCHES = (0.3, 0.8)
#: share of an error's energy in the workspace that its modes have, and the most modes
WHOLE, MODES = 0.98, 24
#: what an error of the workspace may come with: the direction, the payload, the feed
WITH = range(3)


def over_pose(state: State) -> Iterable[Column]:
    """A smooth error over the workspace: products of the scaled pose.

    Up to the third degree for up to three coordinates, else to the second.
    """
    degree = 3 if len(state.machine.command) <= 3 else 2
    yield from powers_on_readings(state, scaled_pose(state), "pose", degree)


def over_travel(state: State) -> Iterable[Column]:
    """An error of each joint over its travel in the session: a random smooth curve."""
    low, high = state.joint_range
    for i in state.limbs:
        at = in_travel(state.joints[:, i], low[i], high[i])
        for k in range(CURVES):
            curve = smooth_basis.curve_mode(
                at, k, correlation_length=BENDS, count=CURVES, detrend=1
            )
            yield on_joint(i, f"travel {k + 1}", UNIT, curve)


def coming_back(state: State, reach: float) -> Iterable[Column]:
    """An error that comes back whenever the machine comes to a place.

    It is a random smooth error of the readings over all joints' travels, of each
    set-up.
    """
    yield from _field(state, reach, np.ones(len(state)))


def coming_back_with(state: State, reach: float, what: float) -> Iterable[Column]:
    """The same with the direction, the payload or the feed."""
    factors = (state.direction, relative_payload(state), relative_feed(state.feed))
    factor = factors[int(what)]
    yield from _field(state, reach, known(factor))


def _field(state: State, reach: float, factor: Array) -> Iterable[Column]:
    """A random smooth error over all joints' travels, times a factor (m,)."""
    if not factor.any():
        return
    low, high = state.joint_range
    joints = [in_travel(state.joints[:, i], low[i], high[i]) for i in state.limbs]
    at = np.column_stack(joints)
    modes = smooth_basis.field_modes(
        at, correlation_length=reach, energy_share=WHOLE, count=MODES
    )
    for k, mode in enumerate(modes.T, start=1):
        yield from on_readings(state, f"{state.setup} {k}", UNIT, factor * mode)
