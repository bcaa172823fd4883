"""What to do next: the physical remedy, or the reading that would tell the members of a
class apart.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from oed.effect import Effect
from oed.gap.data.diagnosis import UNKNOWN, Answer
from oed.gap.data.signature import LACKS

#: probability below which the leading answer is told with its rival
SURE = 0.8


def advise(
    answers: Sequence[Answer],
    effects: Sequence[Effect],
    not_testable: Mapping[str, str],
) -> tuple[str, ...]:
    """Sentences, the most useful first, for the leading answer and, where it is not
    sure, the one behind it.
    """
    known = {e.name: e for e in effects}
    first = answers[0]
    told = _for(first, known)
    if first.probability < SURE and len(answers) > 1:
        told += _between(first, answers[1], known)
    missing = _missing(not_testable)
    if missing and not first.effects:
        told.append(
            "Record more with the readings, and more can be tested:"
            f" {_listed(missing)}."
        )
    elif missing and UNKNOWN in first.effects:
        told.append(
            "What acts may be what these readings cannot test: record"
            f" {_listed(missing)} with them."
        )
    return tuple(dict.fromkeys(told))


def _missing(not_testable: Mapping[str, str]) -> list[str]:
    """The covariates without which effects could not be tested."""
    needs = [
        why.removeprefix(LACKS).split(", ")
        for why in not_testable.values()
        if why.startswith(LACKS)
    ]
    return sorted(
        {re.split(r":| or ", need)[0] for several in needs for need in several}
    )


def _for(answer: Answer, known: Mapping[str, Effect]) -> list[str]:
    told = []
    for effect, members in zip(
        [e for e in answer.effects if e != UNKNOWN], answer.classes, strict=True
    ):
        if len(members) > 1:
            told.append(
                f"These readings cannot tell {_listed(members)} apart: "
                + "; ".join(
                    f"{known[m].exposed_by} would show {m}"
                    for m in members
                    if known[m].exposed_by
                )
                + "."
            )
        elif known[effect].remedy:
            told.append(f"{effect}: {known[effect].remedy}.")
    if answer.effects == (UNKNOWN,):
        told.append(
            "Something acts that no effect of the library explains: look at where it"
            " lies, vary one condition at a time (direction, feed, payload, time) on"
            " the runs that show it, and add an effect of your own."
        )
    elif UNKNOWN in answer.effects:
        told.append(
            "A remainder of unknown shape is left: look at its trace, and at where it"
            " lies, before acting on it."
        )
    if not answer.effects:
        told.append(
            "Nothing beyond the geometry and the noise is seen: compensate the"
            " geometry."
        )
    return told


def _between(first: Answer, second: Answer, known: Mapping[str, Effect]) -> list[str]:
    if not second.effects:
        shown = [
            known[e].exposed_by
            for e in first.effects
            if e in known and known[e].exposed_by
        ]
        more = f" It would be shown by {_listed(shown)}." if shown else ""
        chance = f"{100.0 * second.probability:.0f} %"
        return [
            f"Noise alone has a probability of {chance}: read again before acting on"
            f" the gap.{more}"
        ]
    apart = [
        e
        for e in second.effects
        if e not in first.effects and e in known and known[e].exposed_by
    ]
    return [f"To make sure that it is not {e}: {known[e].exposed_by}." for e in apart]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
