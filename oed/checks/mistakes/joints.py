"""Legs numbered otherwise than in the study, and joints with the other sign."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from oed.checks.mistakes.driven import jointed, permuted, scaled
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import Moved, moved_trial, pose_table
from oed.checks.mistakes.trial import MistakeTrial

#: joints of which every order is tried
EVERY_ORDER = 3
#: log prior of another numbering in part of a file alone: it belongs to the machine
SELDOM = -3.0


def trials(given: Given) -> Iterator[MistakeTrial]:
    """The likely orders of the joints, for the file, each set-up and each run."""
    measurement = given.session.measurement
    joints = measurement.machine.joints
    for order in likely_orders(len(joints)):
        if any(joints[a].unit != joints[b].unit for a, b in enumerate(order)):
            continue
        legs = ", ".join(str(k + 1) for k in order)
        sentence = f"the legs are numbered otherwise: 1 to {len(order)} are {legs}"
        moved = jointed(measurement, permuted(order))
        yield from _trials(given, sentence, moved)
    for k, joint in enumerate(joints):
        if joint.lower < 0.0 < joint.upper:
            moved = jointed(measurement, scaled(k, -1.0))
            yield from _trials(given, f"the sign of {joint.name} is reversed", moved)


def _trials(given: Given, sentence: str, moved: Moved) -> Iterator[MistakeTrial]:
    table = pose_table(given, moved)
    if table is None:
        return
    for scope in given.scopes:
        log_prior = 0.0 if scope.level == "file" else SELDOM
        words = f"{sentence}{scope.within}"
        yield moved_trial(given, "joints", scope, words, moved, table, log_prior)


def likely_orders(count: int) -> list[tuple[int, ...]]:
    """Orders of joints but the first: turned, the other way round, two exchanged."""
    places = tuple(range(count))
    if count <= EVERY_ORDER:
        return [o for o in itertools.permutations(places) if o != places]
    orders = set()
    for turn in range(count):
        turned = tuple(np.roll(places, turn).tolist())
        orders |= {turned, turned[::-1]}
    for a, b in itertools.combinations(places, 2):
        exchanged = list(places)
        exchanged[a], exchanged[b] = b, a
        orders.add(tuple(exchanged))
    return sorted(orders - {places})
