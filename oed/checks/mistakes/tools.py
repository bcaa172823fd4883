"""Tool points other than stated: of what is read, of what the controller drives, of both.

A tool point from another drawing, a reflector beside the axis, a controller that turns
about another pivot, and a study with another tool than the machine had.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from oed.base import units
from oed.base.arrays import Array
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import CANNOT_BE
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, PoseTable
from oed.checks.session import SessionReadings
from oed.checks.words import rounded
from oed.measurement.measurement import Measurement, Series
from oed.model.machine import Tool

#: step of the tool's length for differences, m
STEP = 1e-4
#: the measurement with the tool points of some set-ups moved by a vector, m
Measured = Callable[[tuple[str, ...], tuple[float, ...]], Measurement]
#: the axis of the tool alone, those beside it, and all three together
AXES = ((2,), (0,), (1,), (0, 1, 2))


READ = "the point that is read"
#: what has another tool point than stated, and whether it is read, driven to the
#: commands, or driven so that home stays where it is
POINTS = {
    READ + "{of} is": {"read"},
    "the controller drives a point to the commands{of},": {"driven"},
    "the controller turns the platform{of} about a point": {"driven", "home"},
    "the machine had another tool{of} than the study, its point": {"read", "driven"},
}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each set-up with another tool point, and all of them."""
    session = given.session
    if not any(c.unit == "rad" for c in session.measurement.machine.command):
        return  # without rotation, the tool moves every reading alike
    setups = [scope for scope in given.scopes if scope.level == "set-up"]
    names = list(dict.fromkeys(s.setup for s in session.series))
    choices = [(given.file, names, "")]
    choices += [(s, [n], f" of {n}") for s, n in zip(setups, names, strict=False)]
    measured = _measured(session.measurement)
    for scope, members, of in choices:
        tool = session.measurement.setups[members[0]].tool
        for (words, uses), axes in itertools.product(POINTS.items(), AXES):
            shift = _with_tool(session, measured, members, uses, axes)
            yield from _elsewhere(given, scope, shift, words.format(of=of), axes, tool)


def _elsewhere(
    given: Given,
    scope: Scope,
    shift: Callable[[Array], list[SessionReadings]],
    what: str,
    axes: Sequence[int],
    tool: Tool,
) -> Iterator[MistakeTrial]:
    """A tool point elsewhere: near the stated one, or where it has the other sign."""
    starts = [np.zeros(len(axes))]
    if len(axes) == 1 and tool[axes[0]]:
        starts.append(np.array([-2.0 * tool[axes[0]]]))
    for start in starts:
        table = _table(given, shift, start)
        if table is not None and np.abs(table.by_amount).max() > 0.0:
            yield MistakeTrial(
                kind="tool",
                scope=scope,
                words=partial(_words, what, axes),
                undo=shift,
                amounts=start,
                steps=np.full(len(axes), STEP),
                family=f"{what} {axes} {scope.name} {start}",
                table=table if start.any() else None,
                mask=scope.values(given.session),
                columns=None if start.any() else table.by_amount,
            )


def _table(
    given: Given, shift: Callable[[Array], list[SessionReadings]], start: Array
) -> PoseTable | None:
    """Readings, and slopes over the amounts, from a start on; None where there are none."""

    def read(amounts: Array) -> Array:
        session = shift(amounts)[0]
        return session.measurement.readings(session.series, session.measurement.nominal)

    try:
        first = read(start)
        steps = STEP * np.eye(len(start))
        slopes = np.column_stack([(read(start + s) - first) / STEP for s in steps])
    except CANNOT_BE:
        return None
    spread = np.maximum(0.1 * np.abs(start), STEP) if start.any() else 1.0
    return PoseTable(first, given.slopes, slopes * spread)


def _measured(measurement: Measurement) -> Measured:
    """Measurements with tool points of some set-ups moved, each made once."""

    @functools.cache
    def measured(names: tuple[str, ...], away: tuple[float, ...]) -> Measurement:
        setups = dict(measurement.setups)
        for name in names:
            x, y, z = (t + a for t, a in zip(setups[name].tool, away, strict=True))
            setups[name] = dataclasses.replace(setups[name], tool=(x, y, z))
        return measurement.with_setups(list(setups.values()))

    return measured


def _with_tool(
    session: SessionReadings,
    measured: Measured,
    names: Sequence[str],
    uses: set[str],
    axes: Sequence[int],
) -> Callable[[Array], list[SessionReadings]]:
    """The session with the tool point of these set-ups moved by amounts, m."""
    measurement = session.measurement

    def driven(series: Series, away: Array) -> Series:
        if series.setup not in names or "driven" not in uses:
            return series
        if not np.isfinite(series.command).all():
            raise ValueError("recorded joints have no command")
        tool = np.array(measurement.setups[series.setup].tool) + away
        command = series.command
        if "home" in uses:
            command = measurement.machine.with_tool(command, away)
        x, q = measurement.kinematics.sent(command, tool)
        return dataclasses.replace(series, q=q, start=x)

    def shift(amounts: Array) -> list[SessionReadings]:
        away = np.zeros(3)
        away[list(axes)] = amounts
        series = tuple(driven(s, away) for s in session.series)
        other = measurement
        if "read" in uses:
            other = measured(tuple(names), tuple(away.tolist()))
        return [dataclasses.replace(session, measurement=other, series=series)]

    return shift


def _words(what: str, axes: Sequence[int], amounts: Array, sd: Array) -> str:
    sizes, errors = ([units.number(float(a), "mm") for a in v] for v in (amounts, sd))
    if what.startswith(READ) and axes == (2,):
        way = "longer" if sizes[0] > 0.0 else "shorter"
        of = what.removeprefix(READ).removesuffix(" is")
        size = f"{abs(sizes[0]):.4g} mm (sd {errors[0]:.2g} mm)"
        return f"the tool{of} is {size} {way} than stated"
    parts = [
        f"{rounded(size, error)} mm (sd {error:.2g} mm) in {'xyz'[axis]}"
        for axis, size, error in zip(axes, sizes, errors, strict=True)
    ]
    return f"{what} {', '.join(parts)} from the stated tool point"
