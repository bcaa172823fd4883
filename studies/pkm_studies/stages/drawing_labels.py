"""Finds the points of a drawing that each parameter moves, and names them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base.arrays import Array
from oed.mechanism.kinematics import Kinematics
from oed.result import DrawingLabel

#: change of a parameter, SI, that shows which points it moves
STEP = 1e-4
#: share of the largest movement from which a point takes part
TAKES_PART = 0.5
#: points nearer than this are one, m
SAME_PLACE = 1e-6
#: share of the largest slope of an equation from which a parameter is in it
LEAST_SLOPE = 1e-9
#: points that the equations of a leg join, at most
MOST_ENDS = 2
#: parameters of one place that are named one by one
MOST_NAMES = 4


def parameter_labels(kinematics: Kinematics, x: Array, q: Array) -> list[DrawingLabel]:
    """Labels at the points of the drawing that parameters move, at a pose (nx,), (nq,).

    The pose and the joints are held, so that a joint centre's error moves that centre
    alone. A parameter that moves no point stands in the middle of the points that its
    closure equations join, such as a leg's ends. Others have no label.
    """
    names = [p.name for p in kinematics.machine.parameters]
    moved = [_moved_point(kinematics, x, q, k) for k in range(len(names))]
    places = _with_joined_points(kinematics, x, q, moved)
    members: dict[tuple[float, ...], list[str]] = {}
    for name, place in zip(names, places, strict=True):
        if place is not None and name not in kinematics.machine.frame:
            key = tuple(np.round(place / SAME_PLACE) * SAME_PLACE)
            members.setdefault(key, []).append(name)
    return [
        DrawingLabel([float(v) for v in place], shortened(group), group)
        for place, group in members.items()
    ]


def shortened(names: Sequence[str]) -> str:
    """Names with a common stem in short: da1x, y, z."""
    stems = list(dict.fromkeys(stem for stem, _ in map(_split, names)))
    words = []
    for stem in stems:
        tails = [tail for s, tail in map(_split, names) if s == stem]
        words.append(stem + ", ".join(tails))
    if len(words) > MOST_NAMES:
        words = [*words[:MOST_NAMES], f"+{len(words) - MOST_NAMES}"]
    return " ".join(words)


def _split(name: str) -> tuple[str, str]:
    """Stem and axis of a name: da1x -> da1, x; the axis is empty where there is none."""
    match = re.fullmatch(r"(.*[0-9_])([xyz])", name)
    return (match[1], match[2]) if match else (name, "")


def _moved_point(
    kinematics: Kinematics, x: Array, q: Array, parameter: int
) -> Array | None:
    """The point (3,) of the drawing that the parameter moves; None where it moves none.

    Of several that move alike, such as all of a platform, their mean.
    """
    still = kinematics.machine.nominal
    before = list(_points(kinematics, x, q, still))
    changed = still.copy()
    changed[parameter] += STEP
    after = list(_points(kinematics, x, q, changed))
    if not before:  # a machine without skeleton has no drawing
        return None
    movement = np.linalg.norm(np.array(after) - np.array(before), axis=1)
    if movement.max() < SAME_PLACE:
        return None
    moved = np.array(before)[movement > TAKES_PART * movement.max()]
    distinct = np.unique(np.round(moved / SAME_PLACE), axis=0) * SAME_PLACE
    return np.asarray(distinct.mean(axis=0))


def _points(kinematics: Kinematics, x: Array, q: Array, p: Array) -> Iterator[Array]:
    for line in kinematics.skeleton(x, q, p):
        yield from line


def _with_joined_points(
    kinematics: Kinematics, x: Array, q: Array, moved: Sequence[Array | None]
) -> list[Array | None]:
    """The moved points, and for other parameters the middle of the points they join."""
    nominal = kinematics.machine.nominal
    by_p = kinematics.equations.slopes(x[None], q[None], nominal)[1][0]
    scale = np.abs(by_p).max(axis=1, keepdims=True)
    in_row = np.abs(by_p) > LEAST_SLOPE * scale
    places = list(moved)
    known = {k: place for k, place in enumerate(moved) if place is not None}
    for k in range(len(places)):
        rows = np.flatnonzero(in_row[:, k])
        sharing = [j for j in known if in_row[rows, j].any()]
        points = {tuple(np.round(known[j] / SAME_PLACE)) for j in sharing}
        if k not in known and 1 <= len(points) <= MOST_ENDS:
            places[k] = np.array(sorted(points)).mean(axis=0) * SAME_PLACE
    return places
