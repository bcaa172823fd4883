"""What to do next: the physical remedy, or the reading that would tell the members of a class apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from oed.effect import Effect
from oed.gap.diagnosis import UNKNOWN, Answer
from oed.gap.signature import LACKS

#: probability below which the leading answer is told with its rival
SURE = 0.8


def advise(answers: Sequence[Answer], effects: Sequence[Effect], not_testable: Mapping[str, str]) -> tuple[str, ...]:
    """Sentences, the most useful first, for the leading answer and, where it is not sure, the one behind it."""
    known = {e.name: e for e in effects}
    first = answers[0]
    told = _for(first, known)
    if first.probability < SURE and len(answers) > 1:
        told += _between(first, answers[1], known)
    if not first.effects or UNKNOWN in first.effects:  # what is unknown may be what could not be tested
        told += _more(not_testable)
    return tuple(dict.fromkeys(told))


def _more(not_testable: Mapping[str, str]) -> list[str]:
    """What to record beside the readings, and which effects could be tested then."""
    without: dict[str, list[str]] = {}
    for effect, why in sorted(not_testable.items()):
        if why.startswith(LACKS):
            without.setdefault(why.removeprefix(LACKS), []).append(effect)
    return [
        f"Record {what} with the readings: {_listed(names)} could then be tested." for what, names in without.items()
    ]


def _for(answer: Answer, known: Mapping[str, Effect]) -> list[str]:
    told = []
    for effect, members in zip([e for e in answer.effects if e != UNKNOWN], answer.classes, strict=True):
        if len(members) > 1:
            told.append(
                f"These readings cannot tell {_listed(members)} apart: "
                + "; ".join(f"{known[m].exposed_by} would show {m}" for m in members if known[m].exposed_by)
                + "."
            )
        elif known[effect].remedy:
            told.append(f"{effect}: {known[effect].remedy}.")
    if answer.effects == (UNKNOWN,):
        told.append(
            "Something acts that no effect of the library explains: look at where it lies, vary one condition at a "
            "time (direction, feed, payload, time) on the runs that show it, and add an effect of your own."
        )
    elif UNKNOWN in answer.effects:
        told.append(
            "A remainder of unknown shape is left: look at its trace, and at where it lies, before acting on it."
        )
    if not answer.effects:
        told.append("Nothing beyond the geometry and the noise is seen: compensate the geometry.")
    return told


def _between(first: Answer, second: Answer, known: Mapping[str, Effect]) -> list[str]:
    if not second.effects:
        shown = [known[e].exposed_by for e in first.effects if e in known and known[e].exposed_by]
        more = f" It would be shown by {_listed(shown)}." if shown else ""
        chance = f"{100.0 * second.probability:.0f} %"
        return [f"Noise alone has a probability of {chance}: read again before acting on the gap.{more}"]
    apart = [e for e in second.effects if e not in first.effects and e in known and known[e].exposed_by]
    return [f"To make sure that it is not {e}: {known[e].exposed_by}." for e in apart]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
