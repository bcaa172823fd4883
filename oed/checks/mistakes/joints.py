"""Legs numbered otherwise than in the study, and joints with the other sign."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.checks.mistakes.driven import jointed, permuted, scaled
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import Moved, on_moved, pose_table, undo_moved
from oed.checks.mistakes.trial import MistakeTrial, Words, in_scopes
from oed.checks.words import rounded
from oed.dataset.file_rows import Row

#: joints of which every order is tried
EVERY_ORDER = 3
#: log prior of another numbering in part of a file alone: it belongs to the machine
SELDOM = -3.0
#: standard deviations from which on a reading is far off
FAR = 4.0
#: step of a stop for differences, and spread about where it is sought, SI
STEP, SPREAD = 1e-5, 5e-3


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
        yield from _stopped(given, k, joint.name)


def _trials(given: Given, sentence: str, moved: Moved) -> Iterator[MistakeTrial]:
    table = pose_table(given, moved)
    if table is None:
        return
    on = on_moved(given, "joints", f"{sentence}{{within}}", moved, table, SELDOM)
    yield from in_scopes(given.scopes, on)


# -- joints at a stop ------------------------------------------------------------------


def _stopped(given: Given, k: int, name: str) -> Iterator[MistakeTrial]:
    """A joint that went no further than a stop, where readings are far off beyond it."""
    for is_upper in (True, False):
        sign = 1.0 if is_upper else -1.0
        for stop in _likely_stops(given, k, sign):

            def moved(amount: float, sign: float = sign) -> Moved:
                def stopped(joints: Array) -> Array:
                    value = np.minimum(sign * joints[:, k], sign * amount)
                    return np.column_stack(
                        [*joints.T[:k], sign * value, *joints.T[k + 1 :]]
                    )

                return jointed(given.session.measurement, stopped)

            near = moved(stop + STEP)
            table = pose_table(given, moved(stop), [near], [SPREAD / STEP])
            if table is None:
                continue
            yield MistakeTrial(
                kind="stop",
                scope=given.file,
                words=_stop_words(given, k, name, sign),
                undo=undo_moved(given, given.file, moved),
                amounts=np.array([stop]),
                steps=np.array([STEP]),
                is_blind=True,
                family=f"stop {name} {is_upper}",
                table=table,
                mask=given.file.values(given.session),
            )


def _likely_stops(given: Given, k: int, sign: float) -> list[float]:
    """Values of a joint, SI, beyond which all readings that are far off lie."""
    joints = np.concatenate(
        [sign * s.q[s.index[:, 0], k] for s in given.session.series]
    )
    misfit = np.abs(given.session.y - given.predicted) / given.spread
    worst = np.zeros(len(joints))
    np.maximum.at(worst, given.session.reading_of_value, misfit)
    far = worst > FAR
    if not far.any() or far.sum() > len(far) // 3:
        return []
    order = np.argsort(-joints)
    beyond = np.flatnonzero(far[order])[-1] + 1
    if beyond > far.sum() + 1:
        return []
    ends = joints[order][[beyond - 1, min(beyond, len(order) - 1)]]
    return [sign * float(ends.mean()), sign * float(ends[1])]


def _stop_words(given: Given, k: int, name: str, sign: float) -> Words:
    joint = given.session.measurement.machine.joints[k]
    unit = "deg" if joint.unit == "rad" else "mm"

    def words(amounts: Array, sd: Array) -> str:
        size, error = (units.number(float(v[0]), unit) for v in (amounts, sd))
        way = "longer" if sign > 0.0 else "shorter"
        if unit == "deg":
            way = "further"
        rows = [
            row
            for s, rows in zip(
                given.session.series, _rows_by_series(given), strict=True
            )
            for row, value in zip(rows, s.q[s.index[:, 0], k], strict=True)
            if sign * value > sign * float(amounts[0])
        ]
        listed = ", ".join(str(row) for row in rows)
        return (
            f"{name} went no {way} than {rounded(size, error)} {unit} (sd {error:.2g}"
            f" {unit}): it stood at its stop in the rows {listed}"
        )

    return words


def _rows_by_series(given: Given) -> list[list[Row]]:
    """Rows of the file of the readings of each series."""
    rows, first = [], 0
    for series in given.session.series:
        numbers = np.arange(first, first + len(series))
        rows.append(list(given.session.rows(numbers)))
        first += len(series)
    return rows


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
