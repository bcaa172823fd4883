"""An effect with another expected size, and how plausible a coefficient is by it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable

from oed.model.effect import Column, Effect, State

#: coefficient in expected sizes beyond which it is implausible: a normal one of that
#: spread is there once in two million
IMPLAUSIBLE = 5.0


def with_expected_size(effect: Effect, unit: str, size: float) -> Effect:
    """The effect with its coefficients of an SI unit expected to be `size`, SI.

    The largest of them gets that prior standard deviation; the others, what lets the
    form depart from the textbook's, and constants that are lengths in proportion to the
    size, keep their ratio to it.
    """
    columns = functools.partial(_sized_columns, effect, unit, size)
    if unit != "m":
        return dataclasses.replace(effect, columns=columns)
    constants = {
        name: tuple(value * size / effect.proportional[name] for value in values)
        if name in effect.proportional
        else values
        for name, values in effect.constants.items()
    }
    proportional = dict.fromkeys(effect.proportional, size)
    return dataclasses.replace(
        effect, columns=columns, constants=constants, proportional=proportional
    )


def _sized_columns(
    effect: Effect, unit: str, size: float, state: State, **constants: float
) -> Iterable[Column]:
    columns = list(effect.columns(state, **constants))
    of_unit = [c for c in columns if effect.unit(c.name) == unit]
    largest = max((c.scale for c in of_unit if not c.shape), default=size)
    for column in columns:
        if effect.unit(column.name) == unit:
            scale = column.scale * size / largest
            yield dataclasses.replace(column, scale=scale)
        else:
            yield column


def coefficient_units(effect: Effect) -> tuple[str, ...]:
    """SI units that coefficients of the effect may have."""
    units = list(effect.units.values())
    if "*" not in effect.units:
        units.append("m")
    return tuple(dict.fromkeys(units))
