"""The usual mistakes of a session, each undone in turn.

A mistake gives trials: sessions as they would be without it, for the file, for each
set-up, for each run, and for the first or last rows. All are judged alike
(`oed.checks.explain`), against each other and against no mistake.
"""

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
from oed.checks.mistakes.suspect import Suspect
from oed.checks.mistakes.trial import MistakeTrial

__all__ = ["MistakeTrial", "Suspect", "trials"]

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

#: mistakes that have an amount, concern a part, or show in the noise
_NEVER_WHOLE = (sorting, amounts, tools, contradiction)


def trials(data: Suspect, *, of_noise: bool = False) -> Iterator[MistakeTrial]:
    """Every mistake undone, or that of noise; of a suspect `whole`, whole ones."""
    if of_noise:
        yield from noise.noise_trials(data)
        return
    for mistake in _MISTAKES:
        if not (data.whole and mistake in _NEVER_WHOLE):
            yield from mistake.trials(data)
