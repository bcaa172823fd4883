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
from typing import Any

import numpy as np

from oed.base import Array
from oed.checks.fit import CANNOT_BE
from oed.checks.mistakes.moved import AGAIN_SUFFIX, mounted_again, with_moved
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    PoseTable,
    amount,
    mistakes_of_scopes,
)
from oed.checks.session import SessionReadings
from oed.instrument import Setup
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
        starts = {0.0, *(-2.0 * tool[axes[0]] for tool in tools if len(axes) == 1)}
        for start in sorted(starts, key=abs):
            point = PointMistake(text, uses, axes, np.full(len(axes), start), measured)
            table = point.table(data)
            if table is not None:
                yield from mistakes_of_scopes(scopes, partial(point.trial, table))


def _measured(session: SessionReadings, read: tuple[float, ...]) -> Measurement:
    """The measurement with set-ups once more that read another point, m from theirs."""

    def changed(setup: Setup) -> dict[str, Any]:
        tool = (np.array(setup.tool) + read).tolist()
        return {"station": setup.owner, "tool": tuple(tool)}

    setups = dict.fromkeys(s.setup for s in session.series)
    return mounted_again(session.measurement, setups, changed)


@dataclasses.dataclass(frozen=True, eq=False)
class PointMistake:
    """A tool point elsewhere: near the stated one, or where it has the other sign."""

    text: str  #: what has it, with `{of}`
    uses: set[str]  #: whether it is read, driven, driven about home
    axes: Sequence[int]  #: (k,) along which it is elsewhere
    start: Array  #: (k,) from which amounts are sought, m
    #: measurements with set-ups once more that read another point, m from theirs
    measured: Callable[[tuple[float, ...]], Measurement]

    def undo(self, scope: Scope, amounts: Array) -> list[SessionReadings]:
        """The session with the tool point of a scope moved by amounts, m."""
        measurement = scope.session.measurement
        away = np.zeros(3)
        away[list(self.axes)] = amounts
        read = away if "read" in self.uses else np.zeros(3)
        other = self.measured(tuple(read.tolist()))

        def moved(series: Series) -> Series:
            again = series.setup + AGAIN_SUFFIX
            if "driven" not in self.uses:
                return dataclasses.replace(series, setup=again)
            if not np.isfinite(series.command).all():
                raise ValueError("recorded joints have no command")
            tool = np.array(measurement.setups[series.setup].tool) + away
            command = series.command
            if "home" in self.uses:
                command = measurement.machine.with_tool(command, away)
            x, q = measurement.kinematics.sent(command, tool)
            return dataclasses.replace(series, setup=again, q=q, start=x)

        session = dataclasses.replace(scope.session, measurement=other)
        return [with_moved(session, scope.readings, moved)]

    def table(self, data: Suspect) -> PoseTable | None:
        """Readings, and slopes over the amounts, from the start on; None without."""

        def read(amounts: Array) -> Array:
            session = self.undo(data.file, amounts)[0]
            nominal = session.measurement.nominal
            return session.measurement.readings(session.series, nominal)

        try:
            first = read(self.start)
            steps = LENGTH_STEP * np.eye(len(self.start))
            ahead = np.column_stack([read(self.start + step) for step in steps])
        except CANNOT_BE:
            return None
        slopes = (ahead - first[:, None]) / LENGTH_STEP
        if self.start.any():
            slopes *= np.maximum(0.1 * np.abs(self.start), LENGTH_STEP)
        first = first + data.predicted - data.nominal
        return PoseTable(first, data.slopes, slopes)

    def trial(self, table: PoseTable, scope: Scope) -> MistakeTrial | None:
        """The mistake in a scope; None where nothing is read otherwise."""
        columns = np.where(scope.values[:, None], table.by_amount, 0.0)
        if not columns.any():
            return None
        of = scope.within if scope.is_part else scope.of.replace(" set-up ", " ")
        what = self.text.format(of=of)
        is_far = bool(self.start.any())
        return MistakeTrial(
            kind="tool",
            scope=scope,
            text=partial(_words, what, self.axes),
            change=partial(self.undo, scope),
            amounts=self.start,
            steps=np.full(len(self.axes), LENGTH_STEP),
            family=f"{what} {self.axes} {self.start}",
            table=table if is_far else None,
            columns=None if is_far else columns,
        )


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
