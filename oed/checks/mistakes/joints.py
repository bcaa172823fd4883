"""Legs numbered otherwise than in the study, and joints with the other sign."""

import itertools
from collections.abc import Iterator

import numpy as np

from oed.base import Array
from oed.checks.mistakes.moved import (
    Moved,
    SoughtAmount,
    change_column,
    displaced_trials,
    exchanged,
    jointed,
    moved_trials,
    permuted,
)
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, amount

#: log prior of another numbering in part of a file alone: it belongs to the machine
PART_LOG_PRIOR = -3.0


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """The likely orders of the joints, for the file, each set-up and each run."""
    measurement = data.session.measurement
    joints = measurement.machine.joints
    for order in likely_orders(len(joints)):
        if any(joints[a].unit != joints[b].unit for a, b in enumerate(order)):
            continue
        legs = ", ".join(str(k + 1) for k in order)
        sentence = f"the legs are numbered otherwise: 1 to {len(order)} are {legs}"
        moved = jointed(measurement, permuted(order))
        yield from moved_trials(
            data, "joints", f"{sentence}{{within}}", moved, PART_LOG_PRIOR
        )
    for k, joint in enumerate(joints):
        if joint.lower < 0.0 < joint.upper:
            moved = jointed(measurement, change_column(k, np.negative))
            sentence = f"the sign of {joint.name} is reversed{{within}}"
            yield from moved_trials(data, "joints", sentence, moved, PART_LOG_PRIOR)
        for sign in (1.0, -1.0):
            yield from _stopped(data, k, sign)


# -- joints at a stop ------------------------------------------------------------------
def _stopped(data: Suspect, k: int, sign: float) -> Iterator[MistakeTrial]:
    """A joint that went no further than a stop, where readings are far off beyond it."""

    def moved(end: float) -> Moved:
        stop = np.minimum if sign > 0.0 else np.maximum
        change = change_column(k, lambda values: stop(values, end))
        return jointed(data.session.measurement, change)

    joint = data.session.measurement.machine.joints[k]
    way, unit = ("longer" if sign > 0.0 else "shorter"), "mm"
    if joint.unit == "rad":
        way, unit = "further", "deg"

    def text(scope: Scope, amounts: Array, sd: Array) -> str:
        is_beyond = sign * data.session.joints[:, k] > sign * amounts[0]
        rows = data.session.rows(np.flatnonzero(is_beyond))
        return (
            f"{joint.name} went no {way} than {amount(amounts[0], sd[0], unit, with_sd=True)}:"
            f" it stood at its stop in the rows {', '.join(str(row) for row in rows)}"
        )

    for stop in _likely_stops(data, k, sign):
        sought = SoughtAmount(stop, spread=5e-3, step=1e-5)
        family = f"stop {k} {sign:g}"
        scopes = [data.file]
        yield from displaced_trials(
            data, "stop", text, moved, sought, family, scopes=scopes, is_blind=True
        )


def _likely_stops(data: Suspect, k: int, sign: float) -> list[float]:
    """Values of a joint, SI, beyond which all readings that are far off lie."""
    joints = sign * data.session.joints[:, k]
    misfit = np.abs(data.session.y - data.predicted) / data.spread
    worst = np.zeros(len(joints))
    np.maximum.at(worst, data.session.reading_of_value, misfit)
    far = worst > 4.0
    if not far.any() or far.sum() > len(far) // 3:
        return []
    order = np.argsort(-joints)
    beyond = np.flatnonzero(far[order])[-1] + 1
    if beyond > far.sum() + 1:
        return []
    ends = joints[order][[beyond - 1, min(beyond, len(order) - 1)]]
    return [sign * float(ends.mean()), sign * float(ends[1])]


def likely_orders(count: int) -> list[tuple[int, ...]]:
    """Orders of joints but the first: turned, the other way round, two exchanged."""
    places = tuple(range(count))
    if count <= 3:
        return [o for o in itertools.permutations(places) if o != places]
    orders = set()
    for turn in range(count):
        turned = tuple(np.roll(places, turn).tolist())
        orders |= {turned, turned[::-1]}
    orders |= {exchanged(count, *two) for two in itertools.combinations(places, 2)}
    return sorted(orders - {places})
