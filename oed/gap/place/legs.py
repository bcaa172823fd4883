"""Regions of the legs: errors of one leg with its travel, motion, force and time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.arrays import Array
from oed.gap.data.problem import GapProblem
from oed.gap.place.regions import Region, joint_change
from oed.gap.place.session import cell_starts

#: all legs alike, among the blocks
ALL = "all legs"
#: half-periods of the waves along a leg's travel, and periods of the fine ones
SMOOTH, FINE = np.arange(6), np.arange(2.5, 40.5, 0.5)


def legs(problem: GapProblem) -> Iterator[Region]:
    """Each leg by itself, and the same change in all of them."""
    limbs = problem.states[0].limbs
    by_leg = [list(_bases(problem, limb)) for limb in limbs]
    for limb, bases in enumerate(by_leg):
        for basis in bases:
            yield Region("leg", f"leg {limb + 1}", basis)
    if len(by_leg) > 1:
        for alike in zip(*by_leg, strict=True):
            yield Region("leg", ALL, np.sum(alike, axis=0))


def _bases(problem: GapProblem, limb: int) -> Iterator[Array]:
    """Bases of one leg, the same ones for every leg.

    Smooth in what it may depend on, each alone and all together; with another leg's
    motion; periodic; shifted from a time on.
    """
    series = range(len(problem.states))
    forms = [_smooth_forms(problem, k, limb) for k in series]
    smooth = []
    for name in forms[0]:
        change = [by_name[name] for by_name in forms]
        smooth.append(joint_change(problem, limb, change))
    yield from smooth
    yield np.hstack(smooth)
    for step in range(1, len(problem.states[0].limbs)):
        change = [_with_other_leg(problem, k, limb, step) for k in series]
        yield joint_change(problem, limb, change)
    yield from _periodic(problem, limb)
    yield from _shifted(problem, limb)


def _periodic(problem: GapProblem, limb: int) -> Iterator[Array]:
    """Waves of fine periods along a leg's travel, each with its phase free."""
    places = [_travel(problem, k, limb) for k in range(len(problem.states))]
    angles = [2.0 * np.pi * place[:, None] * FINE for place in places]
    sine = joint_change(problem, limb, [np.sin(angle) for angle in angles])
    cosine = joint_change(problem, limb, [np.cos(angle) for angle in angles])
    for k in range(len(FINE)):
        yield np.column_stack([sine[:, k], cosine[:, k]])


def _shifted(problem: GapProblem, limb: int) -> Iterator[Array]:
    """A shift of the leg from the start of each cell of the session but the first."""
    starts = cell_starts(problem)
    if len(starts) <= 1:
        return
    shifts = []
    for state in problem.states:
        times = np.nan_to_num(state.time, nan=-np.inf)
        shifts.append((times[:, None] >= starts[1:]).astype(float))
    yield from joint_change(problem, limb, shifts).T[:, :, None]


def _travel(problem: GapProblem, number: int, limb: int) -> Array:
    """Place (m,) of a leg in its travel over all series, 0 to 1."""
    joints = [state.joints[:, limb] for state in problem.states]
    every = np.concatenate(joints)
    span = float(np.ptp(every))
    offset = joints[number] - every.min()
    return np.asarray(offset / (span if span > 0.0 else 1.0))


def _smooth_forms(problem: GapProblem, number: int, limb: int) -> dict[str, Array]:
    """What a leg's error may be a smooth function of, (m, k) each.

    The names are the same for every leg and series.
    """
    state, u = problem.states[number], _travel(problem, number, limb)
    ones = np.ones_like(u)
    linear = np.column_stack([ones, u])
    forms = {
        "travel": np.cos(np.pi * u[:, None] * SMOOTH),
        "sense": state.motion_sign[:, limb, None] * linear,
    }
    force = np.zeros_like(u)
    if np.isfinite(state.tool_force).all():
        force = state.tool_force[:, limb]
    load = np.nan_to_num(state.payload)
    by_load = np.column_stack([ones, u, load, load * u])
    forms["load"] = force[:, None] * by_load
    if np.isfinite(state.session_span).all():
        first, last = state.session_span
        duration = max(last - first, 1e-12)
        at = np.nan_to_num((state.time - first) / duration)
        forms["time"] = np.column_stack([at, at**2, at * u])
    if all(np.isfinite(s.rate).all() for s in problem.states):
        forms["rate"] = state.rate[:, limb, None] * linear
    return forms


def _with_other_leg(
    problem: GapProblem,
    number: int,
    limb: int,
    step: int,
) -> Array:
    """Errors (m, 3) of a leg that come with the motion of the one `step` legs on."""
    state, u = problem.states[number], _travel(problem, number, limb)
    other = (limb + step) % len(state.limbs)
    motion = np.where(np.isfinite(state.rate), state.rate, state.motion_sign)
    rate = motion[:, other]
    return np.column_stack([rate, np.abs(rate), rate * u])
