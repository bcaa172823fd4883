"""Tool points other than stated: of what is read, of what the controller drives, of both.

A tool point from another drawing, a reflector beside the axis or on another nest, another
ball, a controller that turns about another pivot, and a study with another tool than the
machine had.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from oed.base import Array
from oed.checks.fit import CANNOT_BE
from oed.checks.mistakes.moved import AGAIN_SUFFIX, Moved, mounted_again, with_moved
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    PoseTable,
    amount,
    mistakes_of_scopes,
)
from oed.checks.session import SessionReadings
from oed.measurement import Measurement, Series

LENGTH_STEP = 1e-4  #: step of the tool's length for differences, m
#: the axis of the tool alone, those beside it, and all three together
AXIS_SETS = ((2,), (0,), (1,), (0, 1, 2))
POINT_READ = "the point that is read"
#: what has another tool point than stated, and whether it is read, driven to the
#: commands, or driven so that home stays where it is
POINT_USES = {
    POINT_READ + "{of} is": {"read"},
    "the controller drives a point to the commands{of},": {"driven"},
    "the controller turns the platform{of} about a point": {"driven", "home"},
    "the machine had another tool{of} than the study, its point": {"read", "driven"},
}


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Each tool point elsewhere in the file and each set-up; that which is read in runs."""
    session = data.session
    if not any(c.unit == "rad" for c in session.measurement.machine.command):
        return  # without rotation, the tool moves every reading alike
    tools = {session.measurement.setups[s.setup].tool for s in session.series}
    measured = functools.cache(partial(_measured, session))
    wholes = [scope for scope in data.scopes if not scope.is_part]
    for (text, uses), axes in itertools.product(POINT_USES.items(), AXIS_SETS):
        scopes = data.scopes if uses == {"read"} else wholes
        shift = _shifts(session, measured, uses, axes)
        starts = {0.0, *(-2.0 * tool[axes[0]] for tool in tools if len(axes) == 1)}
        for start in sorted(starts, key=abs):
            amounts = np.full(len(axes), start)
            table = _table(data, partial(shift, data.file), amounts)
            if table is not None:
                on = partial(_elsewhere, shift, text, axes, amounts, table)
                yield from mistakes_of_scopes(scopes, on)


#: the session with the tool point of a scope moved by amounts, m
Shift = Callable[[Scope, Array], list[SessionReadings]]


def _elsewhere(
    shift: Shift,
    text: str,
    axes: Sequence[int],
    start: Array,
    table: PoseTable,
    scope: Scope,
) -> MistakeTrial | None:
    """A tool point elsewhere: near the stated one, or where it has the other sign."""
    columns = np.where(scope.values[:, None], table.by_amount, 0.0)
    if not columns.any():
        return None
    of = scope.within if scope.is_part else scope.of.replace(" set-up ", " ")
    what = text.format(of=of)
    return MistakeTrial(
        kind="tool",
        scope=scope,
        text=partial(_words, what, axes),
        change=partial(shift, scope),
        amounts=start,
        steps=np.full(len(axes), LENGTH_STEP),
        family=f"{what} {axes} {start}",
        table=table if start.any() else None,
        columns=None if start.any() else columns,
    )


def _table(
    data: Suspect, shift: Callable[[Array], list[SessionReadings]], start: Array
) -> PoseTable | None:
    """Readings, and slopes over the amounts, from a start on; None where there are none."""

    def read(amounts: Array) -> Array:
        session = shift(amounts)[0]
        return session.measurement.readings(session.series, session.measurement.nominal)

    try:
        first = read(start)
        steps = LENGTH_STEP * np.eye(len(start))
        slopes = np.column_stack(
            [(read(start + s) - first) / LENGTH_STEP for s in steps]
        )
    except CANNOT_BE:
        return None
    spread = np.maximum(0.1 * np.abs(start), LENGTH_STEP) if start.any() else 1.0
    first = first + data.predicted - data.nominal
    return PoseTable(first, data.slopes, slopes * spread)


def _measured(session: SessionReadings, read: tuple[float, ...]) -> Measurement:
    """The measurement with set-ups once more that read another point, m from theirs."""
    return mounted_again(
        session.measurement,
        dict.fromkeys(s.setup for s in session.series),
        lambda s: {
            "station": s.owner,
            "tool": tuple((np.array(s.tool) + read).tolist()),
        },
    )


def _shifts(
    session: SessionReadings,
    measured: Callable[[tuple[float, ...]], Measurement],
    uses: set[str],
    axes: Sequence[int],
) -> Shift:
    measurement = session.measurement

    def moved_by(away: Array) -> Moved:
        def moved(series: Series) -> Series:
            again = series.setup + AGAIN_SUFFIX
            if "driven" not in uses:
                return dataclasses.replace(series, setup=again)
            if not np.isfinite(series.command).all():
                raise ValueError("recorded joints have no command")
            tool = np.array(measurement.setups[series.setup].tool) + away
            command = series.command
            if "home" in uses:
                command = measurement.machine.with_tool(command, away)
            x, q = measurement.kinematics.sent(command, tool)
            return dataclasses.replace(series, setup=again, q=q, start=x)

        return moved

    def shift(scope: Scope, amounts: Array) -> list[SessionReadings]:
        away = np.zeros(3)
        away[list(axes)] = amounts
        read = away if "read" in uses else np.zeros(3)
        other = dataclasses.replace(session, measurement=measured(tuple(read.tolist())))
        return [with_moved(other, scope.readings, moved_by(away))]

    return shift


def _words(what: str, axes: Sequence[int], amounts: Array, sd: Array) -> str:
    """A tool point elsewhere, along the axes that matter."""
    sizes = dict(zip(axes, zip(amounts, sd, strict=True), strict=True))
    least = 0.01 * float(np.abs(amounts).max())
    sizes = {
        k: (a, e) for k, (a, e) in sizes.items() if abs(a) >= max(3.0 * e, least)
    } or sizes
    if what.startswith(POINT_READ) and list(sizes) == [2]:
        value, error = sizes[2]
        way = "longer" if value > 0.0 else "shorter"
        of = what.removeprefix(POINT_READ).removesuffix(" is")
        size = amount(abs(value), error, "mm", with_sd=True)
        return f"the tool{of} is {size} {way} than stated"
    parts = [
        f"{amount(value, error, 'mm', with_sd=True)} in {'xyz'[axis]}"
        for axis, (value, error) in sizes.items()
    ]
    return f"{what} {', '.join(parts)} from the stated tool point"
