"""Judgement of one answer in one case, without statistics.

An answer names effects, each perhaps with others that are indistinguishable from it
(its class), and maybe an unknown remainder. A class is right where it has the true
effect.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

UNKNOWN = "unknown"
#: overlap of two blocks (intersection over union) from which one is where the other is
OVERLAP = 1.0 / 3.0
#: p-value up to which a block is claimed
CLAIMED = 0.05
SPAN = re.compile(r"(-?\d+(?:\.\d+)?)-(-?\d+(?:\.\d+)?)$")


@dataclasses.dataclass(frozen=True, slots=True)
class StatedAnswer:
    """An answer as a method states it.

    classes        a class for each effect that it names
    unknown        whether an unknown is among them
    probability    of the answer
    """

    classes: tuple[tuple[str, ...], ...] = ()
    unknown: bool = False
    probability: float = 1.0

    @property
    def gap(self) -> bool:
        """Whether it says that there is a gap."""
        return bool(self.classes) or self.unknown


def parse_answer(answer: Mapping[str, Any]) -> StatedAnswer:
    """An answer of a result.

    Raises ValueError where its classes do not belong to its effects.
    """
    names = [n for n in answer["effects"] if n != UNKNOWN]
    classes = [tuple(c) for c in answer.get("classes", [])]
    classes = classes or [(n,) for n in names]
    if len(classes) != len(names) or any(
        n not in c for n, c in zip(names, classes, strict=True)
    ):
        raise ValueError(f"the answer {answer} has other classes than effects")
    unknown = UNKNOWN in answer["effects"]
    probability = float(answer.get("probability", 1.0))
    return StatedAnswer(tuple(classes), unknown, probability)


def count_true(answer: StatedAnswer, truth: Sequence[str]) -> int:
    """How many true effects the answer names, each by another class."""
    best = 0
    number = len(answer.classes)
    for order in itertools.permutations(truth):
        size = min(len(order), number)
        for chosen in itertools.combinations(range(number), size):
            pairs = zip(order, chosen, strict=False)
            hits = sum(name in answer.classes[k] for name, k in pairs)
            best = max(best, hits)
    return best


def names_exactly(answer: StatedAnswer, truth: Sequence[str]) -> bool:
    """Whether it names the true effects and no other, with or without an unknown."""
    if len(answer.classes) != len(truth):
        return False
    return count_true(answer, truth) == len(truth)


def count_false(answer: StatedAnswer, truth: Sequence[str]) -> int:
    """How many effects it names that do not act."""
    return len(answer.classes) - count_true(answer, truth)


def is_right(answer: StatedAnswer, truth: Sequence[str], unknown: bool) -> bool:
    """Whether the answer is right as a whole.

    unknown: an effect that is in no library acts; the answer must state it, unless it
    names known ones. Where only known effects act, an unknown remainder with their
    names is no fault; where nothing acts, nothing may be named.
    """
    if not names_exactly(answer, truth):
        return False
    return bool(truth) or answer.unknown == unknown


def located(
    where: Sequence[Mapping[str, Any]],
    blocks: Sequence[str],
    kind: str,
) -> bool:
    """Whether the likeliest claimed block of a kind is one of the true blocks.

    Kinds are `leg`, `run`, `time`, ...
    """
    of_kind = [w for w in where if _kind(w["block"]) == kind]
    claimed = [w for w in of_kind if _p(w) <= CLAIMED]
    if not claimed:
        return False
    first = min(claimed, key=lambda w: (_p(w), -(w.get("strength") or 0.0)))
    true_blocks = [b for b in blocks if _kind(b) == kind]
    return any(same_place(first["block"], b) for b in true_blocks)


def _kind(block: str) -> str:
    return block.split(" ")[0]


def _p(block: Mapping[str, Any]) -> float:
    p = block["p_value"]
    return 1.0 if p is None else float(p)


def same_place(one: str, other: str) -> bool:
    """Whether two blocks are the same place.

    Spans of time or phase are where they overlap by OVERLAP, others by name.
    """
    if one == other:
        return True
    a, b = SPAN.search(one), SPAN.search(other)
    kind = _kind(one)
    if a is None or b is None or kind != _kind(other):
        return False
    if kind not in ("time", "phase"):
        return False
    turn = 360.0 if kind == "phase" else 0.0
    first = _pieces(float(a[1]), float(a[2]), turn)
    second = _pieces(float(b[1]), float(b[2]), turn)
    both = sum(_overlap(p, q) for p in first for q in second)
    whole = _length(first) + _length(second) - both
    return whole > 0.0 and both / whole >= OVERLAP


def _overlap(p: tuple[float, float], q: tuple[float, float]) -> float:
    """Length of what two stretches share."""
    return max(0.0, min(p[1], q[1]) - max(p[0], q[0]))


def _length(pieces: Sequence[tuple[float, float]]) -> float:
    return sum(high - low for low, high in pieces)


def _pieces(low: float, high: float, turn: float) -> list[tuple[float, float]]:
    """A span as stretches from low to high; one that passes a full turn as two."""
    if high >= low:
        return [(low, high)]
    return [(low, turn), (0.0, high)] if turn else [(high, low)]
