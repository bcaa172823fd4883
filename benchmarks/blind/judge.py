"""Whether an answer is right: one case, one answer, no statistics.

An answer names effects, each perhaps with others that the readings cannot tell from it
(its class), and maybe an unknown remainder. A class is right where it holds the true
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
class Said:
    """An answer: a class for each effect that it names, whether an unknown is among
    them, its probability.
    """

    classes: tuple[tuple[str, ...], ...] = ()
    unknown: bool = False
    probability: float = 1.0

    @property
    def gap(self) -> bool:
        """Whether it says that there is a gap."""
        return bool(self.classes) or self.unknown


def said(answer: Mapping[str, Any]) -> Said:
    """An answer of a result. Raises ValueError where its classes do not belong to its
    effects.
    """
    names = [n for n in answer["effects"] if n != UNKNOWN]
    classes = [tuple(c) for c in answer.get("classes", [])] or [(n,) for n in names]
    if len(classes) != len(names) or any(
        n not in c for n, c in zip(names, classes, strict=True)
    ):
        raise ValueError(f"the answer {answer} has other classes than effects")
    return Said(
        tuple(classes),
        UNKNOWN in answer["effects"],
        float(answer.get("probability", 1.0)),
    )


def found(answer: Said, truth: Sequence[str]) -> int:
    """How many true effects the answer names, each by a class of its own."""
    best = 0
    for order in itertools.permutations(truth):
        for chosen in itertools.combinations(
            range(len(answer.classes)), min(len(order), len(answer.classes))
        ):
            best = max(
                best,
                sum(
                    name in answer.classes[k]
                    for name, k in zip(order, chosen, strict=False)
                ),
            )
    return best


def exactly(answer: Said, truth: Sequence[str]) -> bool:
    """Whether it names the true effects and no other; an unknown remainder may stand
    beside them.
    """
    return len(answer.classes) == len(truth) and found(answer, truth) == len(truth)


def false_effects(answer: Said, truth: Sequence[str]) -> int:
    """How many effects it names that do not act."""
    return len(answer.classes) - found(answer, truth)


def right(answer: Said, truth: Sequence[str], unknown: bool) -> bool:
    """Whether the answer is right as a whole.

    unknown: an effect that is in no library acts; it must be said, unless known ones
    are named with it. Where only known effects act, an unknown remainder beside their
    names is no fault; where nothing acts, nothing may be named.
    """
    if not exactly(answer, truth):
        return False
    return bool(truth) or answer.unknown == unknown


def located(
    where: Sequence[Mapping[str, Any]], blocks: Sequence[str], kind: str
) -> bool:
    """Whether the likeliest claimed block of a kind (`leg`, `run`, `time`, ...) is one
    of the true blocks.
    """
    claimed = [
        w for w in where if w["block"].split(" ")[0] == kind and _p(w) <= CLAIMED
    ]
    if not claimed:
        return False
    first = min(claimed, key=lambda w: (_p(w), -(w.get("strength") or 0.0)))
    return any(same(first["block"], b) for b in blocks if b.split(" ")[0] == kind)


def _p(block: Mapping[str, Any]) -> float:
    p = block["p_value"]
    return 1.0 if p is None else float(p)


def same(one: str, other: str) -> bool:
    """Whether two blocks are the same place: spans of time or phase where they overlap
    by OVERLAP, others by name.
    """
    if one == other:
        return True
    a, b = SPAN.search(one), SPAN.search(other)
    kind = one.split(" ")[0]
    if (
        a is None
        or b is None
        or kind != other.split(" ")[0]
        or kind not in ("time", "phase")
    ):
        return False
    turn = 360.0 if kind == "phase" else 0.0
    first, second = (
        _pieces(float(a[1]), float(a[2]), turn),
        _pieces(float(b[1]), float(b[2]), turn),
    )
    both = sum(
        max(0.0, min(p[1], q[1]) - max(p[0], q[0])) for p in first for q in second
    )
    whole = sum(p[1] - p[0] for p in first) + sum(q[1] - q[0] for q in second) - both
    return whole > 0.0 and both / whole >= OVERLAP


def _pieces(low: float, high: float, turn: float) -> list[tuple[float, float]]:
    """A span as stretches from low to high; one that passes a full turn as two."""
    if high >= low:
        return [(low, high)]
    return [(low, turn), (0.0, high)] if turn else [(high, low)]
