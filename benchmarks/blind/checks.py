"""Checks of one answer in one case; an answer of None is a failed diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from benchmarks.blind import judge
from benchmarks.blind.entries import Entry
from benchmarks.blind.judge import StatedAnswer

Check = Callable[[Entry, StatedAnswer | None], bool]


def alarm(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer states a gap; so does a failure."""
    return answer is None or answer.gap


def detected(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer states a gap."""
    return answer is not None and answer.gap


def right_class(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer names the true effects, and no other."""
    return answer is not None and judge.names_exactly(answer, e.known)


def flagged(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer states an unknown."""
    return answer is not None and answer.unknown


def unknown_alone(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer states nothing but an unknown; so does a failure."""
    return answer is None or (answer.unknown and not answer.classes)


def one_member(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer names one member of an exact class without the other."""
    if answer is None:
        return True
    members = set(e.label["class"])
    classes = [set(names) for names in answer.classes]
    return any(members & names and not members <= names for names in classes)


def named(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer names an effect; so does a failure."""
    return answer is None or bool(answer.classes)


def rightly(e: Entry, answer: StatedAnswer | None) -> bool:
    """The answer states a gap where there is one, and none where there is none."""
    return answer is not None and answer.gap == (e.kind != "null")


def is_right(e: Entry, answer: StatedAnswer) -> bool:
    """The answer is right as a whole."""
    return judge.is_right(answer, e.known, e.unknown)


def check_all(entries: Sequence[Entry], check: Check, method: str) -> list[bool]:
    """A check over all cases that a method answered."""
    return [check(e, e.best[method]) for e in entries if method in e.best]
