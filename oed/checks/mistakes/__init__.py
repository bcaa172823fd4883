"""The usual mistakes of a session, each undone in turn.

A mistake gives trials: sessions as they would be without it, for the file, for each
set-up, for each run, and for the first or last rows. All are judged alike
(`oed.checks.explain`), against each other and against no mistake.

trial          a session with one mistake undone
scope          the part of a session that a mistake concerns
given          the readings as given, with what is predicted of them, and which of them
               one instrument may have taken in several set-ups
values         readings in another unit, as deviations, with a sign or a factor
order          readings in another order, or of another run
sorting        readings sorted, or in an unknown order
setups         readings of another set-up, or differences from another pose of their run
moved, driven  series at other poses
pose           commanded poses with wrong signs, columns or offsets; another program of a
               fixed length: a circle at another height
joints         legs numbered otherwise
noise          noise in another unit, and commands whose decimals were lost
frames         columns exchanged, axes turned, poses in another frame, or with another
               meaning of their angles
carried        readings that hold parts of others: a lag, differences, sums, means
limits         clipped readings, revolutions not counted
amounts        wrong zeros inside an instrument, such as a dead length, offsets, factors,
               set-ups that moved, wrong sizes
tools          other tool points of instrument, controller or study
contradiction  two parts of a session that fit alone, a run that contradicts all others, or
               has the readings of another one
"""

from __future__ import annotations

from collections.abc import Iterator

from oed.checks.mistakes import (
    amounts,
    carried,
    contradiction,
    frames,
    joints,
    limits,
    noise,
    order,
    pose,
    setups,
    sorting,
    tools,
    values,
)
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.trial import MistakeTrial

__all__ = ["PHYSICAL", "Given", "MistakeTrial", "trials"]

_MISTAKES = (
    values,
    frames,
    carried,
    limits,
    order,
    sorting,
    setups,
    pose,
    noise,
    joints,
    amounts,
    tools,
    contradiction,
)

#: kinds that an effect of the machine can mimic: a diagnosis tells them apart
PHYSICAL = ("offset", "run", "factor", "tool", "size", "change", "contradiction")


def trials(given: Given, *, of_noise: bool = False) -> Iterator[MistakeTrial]:
    """Every mistake of a session, undone; those of its noise alone."""
    if of_noise:
        yield from noise.noise_trials(given)
        return
    for mistake in _MISTAKES:
        yield from mistake.trials(given)
