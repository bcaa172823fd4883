"""The usual mistakes of a session, each undone in turn.

A mistake gives trials: sessions as they would be without it, for the file, for each
set-up, for each run, and for the first or last rows. All are judged alike
(`oed.checks.explain`), against each other and against no mistake.

trial          a session with one mistake undone
scope          the part of a session that a mistake concerns
given          the readings as given, with what is predicted of them, and which of them
               one instrument may have taken in several set-ups
values         readings in another unit, as deviations, with a sign or a factor
columns        columns of readings exchanged, or axes turned
order          readings in another order, or of another run
sorting        readings sorted, or in an unknown order
copied         readings of one run or set-up in another one
setups         readings of another set-up
moved, driven  series at other poses
pose           commanded poses with wrong signs, columns or offsets
program        another program of a fixed length: a circle at another height
joints         legs numbered otherwise
reference      differences from another pose of their run
amounts        wrong zeros inside an instrument, such as a dead length, offsets, factors,
               other tools, set-ups that moved, wrong sizes
contradiction  two parts of a session that fit alone, a run that contradicts all others
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from oed.checks.mistakes import (
    amounts,
    columns,
    contradiction,
    copied,
    joints,
    order,
    pose,
    program,
    reference,
    setups,
    sorting,
    values,
)
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import Alternatives, MistakeTrial

__all__ = ["PHYSICAL", "Alternatives", "Given", "MistakeTrial", "trials", "trials_near"]

_MISTAKES = (
    values,
    columns,
    order,
    sorting,
    copied,
    setups,
    pose,
    program,
    joints,
    reference,
    amounts,
    contradiction,
)

#: kinds that an effect of the machine can mimic: a diagnosis tells them apart
PHYSICAL = ("offset", "run", "factor", "tool", "size", "change", "contradiction")


#: mistakes that may concern the first or last rows of a set-up or run
_OF_ROWS = (values, order, amounts)


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Every mistake of a session, undone."""
    for mistake in _MISTAKES:
        yield from mistake.trials(given)


def trials_near(given: Given, parts: Sequence[Scope]) -> Iterator[MistakeTrial]:
    """Mistakes of rows that begin or end near those of some parts."""
    near = dataclasses.replace(given, near=tuple(parts))
    for mistake in _OF_ROWS:
        for trial in mistake.trials(near):
            if trial.scope.level == "rows":
                yield trial
