"""Effects of no known form: smooth errors of the tool, of single joints and of the readings.

Each is a Gaussian process of the workspace, of the workspace with the direction of
motion, or of the time, as a series of cosines on a box a little larger than what the
session visits (Solin and Sarkka 2020, Stat. Comput. 30, 419-446). The variance falls
with the order. Their sizes are given by the caller.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from oed.base import Array
from oed.effect_model import Column, Effect, State

#: terms of a series over the workspace
WORKSPACE_TERMS = 24
#: terms of a series over the time
TIME_TERMS = 10
#: half width of the box over that of what the session visits
BOX_FACTOR = 1.25
#: order at which the variance has fallen to a quarter
QUARTER_ORDER = 2.0
#: size of a unit coefficient, in the unit of the joint, the tool's m or the reading
UNIT_SIZE = 1e-6

#: what a course is a function of
NEEDS = {"direction": ("direction: both",), "time": ("time",)}

Series = Callable[[State], Array]


def unknown_effects() -> tuple[Effect, ...]:
    """Effects of no known form, for any machine."""
    series: dict[str, Series] = {
        "place": over_places,
        "direction": over_places,
        "time": over_time,
    }
    carriers = {"tool": _on_tool, "joints": _on_joints, "readings": _on_readings}
    effects = []
    for (carrier, columns), (course, values) in itertools.product(
        carriers.items(), series.items()
    ):
        if carrier == "readings" and course == "direction":
            continue
        effects.append(
            Effect(
                name=f"unknown {carrier} {course}",
                source="Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464",
                about=f"an error of the {carrier} of no known form ({course})",
                columns=_columns(columns, values, course == "direction"),
                needs=NEEDS.get(course, ()),
            )
        )
    return tuple(effects)


def _columns(
    on_carrier: Callable[[State, Array, bool], Iterable[Column]],
    series: Series,
    reverses: bool,
) -> Callable[[State], Iterable[Column]]:
    """The columns of one carrier (it knows its own sense of motion) and one series."""

    def columns(state: State) -> Iterable[Column]:
        return on_carrier(state, series(state), reverses)

    return columns


def over_places(state: State) -> Array:
    """Terms (m, k) of a smooth function of the joints in their travels."""
    return np.column_stack(list(_terms(state.travel, WORKSPACE_TERMS)))


def over_time(state: State) -> Array:
    """Terms (m, k) of a smooth function of the session's course."""
    course = 2.0 * state.session_progress[:, None] - 1.0
    return np.column_stack(list(_terms(course, TIME_TERMS)))


def _terms(places: Array, count: int) -> Iterator[Array]:
    """Products (m,) of cosines of the coordinates (m, d), the smoothest `count`."""
    angle = 0.5 * np.pi * (places / BOX_FACTOR + 1.0)
    for orders in _smoothest(places.shape[1], count):
        waves = np.prod(np.cos(angle * orders), axis=1)
        yield waves / (1.0 + (orders @ orders) / QUARTER_ORDER**2)


@functools.cache
def _smoothest(dimensions: int, count: int) -> Array:
    """Orders (count, d) of the products, the smoothest first, the constant left out."""
    most = 8 if dimensions <= 2 else 3
    if dimensions == 1:
        most = count
    grid = itertools.product(range(most + 1), repeat=dimensions)
    ranked = sorted(grid, key=lambda orders: (sum(k * k for k in orders), orders))
    return np.array(ranked[1 : count + 1], dtype=float)


def _on_tool(state: State, terms: Array, reverses: bool) -> Iterable[Column]:
    """Displacements of the tool along the axes of the base."""
    sense = _zero_where_unknown(state.direction) if reverses else 1.0
    for axis, name in enumerate("xyz"):
        for k, term in enumerate(terms.T):
            joints = state.displacing_joints(axis, sense * term)
            yield Column(f"{name} {k + 1}", UNIT_SIZE, joints=joints)


def _on_joints(state: State, terms: Array, reverses: bool) -> Iterable[Column]:
    """Errors of each joint by itself."""
    for i in state.limbs:
        sense = _zero_where_unknown(state.motion_sign[:, i]) if reverses else 1.0
        leg = f"leg {i + 1}"
        for k, term in enumerate(terms.T):
            yield Column(f"{leg} {k + 1}", UNIT_SIZE, leg, {i: sense * term})


def _on_readings(state: State, terms: Array, reverses: bool) -> Iterable[Column]:
    """Errors of the instrument, in each channel of each set-up."""
    for channel in state.channels:
        label = f"{state.setup} {channel}"
        for k, term in enumerate(terms.T):
            yield Column(f"{label} {k + 1}", UNIT_SIZE, label, reading={channel: term})


def _zero_where_unknown(values: Array) -> Array:
    """Values, 0 where they are not known."""
    return np.where(np.isfinite(values), values, 0.0)
