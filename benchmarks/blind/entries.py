"""What the scorer reads: of every case its label, the oracle's figures and the result,
as one entry.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import judge
from benchmarks.blind.judge import Said

DIAGNOSIS, BASELINES = "diagnosis", ("harmonic", "stepwise")
#: machine that nobody who developed the diagnosis had
UNSEEN = "hexapod"
#: column of the readings by which a kind of place is told
TOLD_BY = {"time": "time_s", "direction": "direction"}


@dataclasses.dataclass(frozen=True)
class Entry:
    """A case and what was said of it.

    label, oracle   see `generator.cases.label` and `oracle`
    said            best answer of each method; None where the diagnosis failed
    answers, set95  all of the diagnosis's answers, and those that have 95 %
    result          as written by `run`
    """

    label: Mapping[str, Any]
    oracle: Mapping[str, Any]
    said: Mapping[str, Said | None]
    answers: tuple[Said, ...]
    set95: tuple[Said, ...]
    result: Mapping[str, Any]

    @property
    def kind(self) -> str:
        """Kind of case: null, single, pair, exact, unknown, known_unknown."""
        return str(self.label["kind"])

    @property
    def machine(self) -> str:
        """Machine."""
        return str(self.label["machine"])

    @property
    def law(self) -> str:
        """Noise law."""
        return str(self.label["noise"]["name"])

    @property
    def known(self) -> tuple[str, ...]:
        """True effects that the library may have."""
        return tuple(e["name"] for e in self.label["effects"] if not e["unknown"])

    @property
    def unknown(self) -> bool:
        """Whether an effect acts that nobody's library has."""
        return any(e["unknown"] for e in self.label["effects"])

    @property
    def severity(self) -> float:
        """sqrt(lambda) that the case was made for: the least of its effects, each
        beside the others; 0 without any.
        """
        return min((float(e["target"]) for e in self.label["effects"]), default=0.0)

    @property
    def testable(self) -> bool:
        """Whether these readings can test every known effect that acts."""
        return set(self.known) <= set(self.oracle["testable"])

    @property
    def apart(self) -> float:
        """Least sqrt(lambda_k|j) over known effects and their rivals; 0 without any."""
        pairs = zip(self.label["effects"], self.oracle["effects"], strict=True)
        return min(
            (float(o["apart"]) for e, o in pairs if not e["unknown"]), default=0.0
        )

    @property
    def shown(self) -> float:
        """Least sqrt(lambda) over known effects by which the library's form of it
        explains more than any rival's; 0 where a rival's explains more.
        """
        pairs = zip(self.label["effects"], self.oracle["effects"], strict=True)
        told = (
            float(o["apart"]) ** 2 - float(o["own"]) ** 2
            for e, o in pairs
            if not e["unknown"]
        )
        return math.sqrt(max(min(told, default=0.0), 0.0))

    @property
    def leg_shown(self) -> float:
        """sqrt(lambda) by which a form of the library in a leg where the only effect
        acts explains more than any in another leg; 0 where one in another explains
        more, or where it acts in none.
        """
        (effect,), (told,) = self.label["effects"], self.oracle["effects"]
        left, whole = told.get("legs", {}), float(effect["sqrt_lambda"])
        here = min(
            (float(v) for leg, v in left.items() if leg in self.blocks), default=whole
        )
        other = min(
            (float(v) for leg, v in left.items() if leg not in self.blocks),
            default=whole,
        )
        return math.sqrt(max(other**2 - here**2, 0.0))

    @property
    def beyond(self) -> float:
        """sqrt(lambda) of the unknown effect that no library effect can take over; 0
        without any.
        """
        pairs = zip(self.label["effects"], self.oracle["effects"], strict=True)
        return max((float(o["beyond"]) for e, o in pairs if e["unknown"]), default=0.0)

    @property
    def blocks(self) -> tuple[str, ...]:
        """Where the effects act, where that is in part and the readings have the column
        that tells it; with legs in which they would make the same readings.
        """
        missing = {
            kind
            for kind, column in TOLD_BY.items()
            if column not in self.label.get("columns", (column,))
        }
        true = [
            b
            for e in self.label["effects"]
            for b in e["blocks"]
            if b.split(" ")[0] not in missing
        ]
        ties = [group for e in self.oracle["effects"] for group in e.get("tied", ())]
        return tuple(
            dict.fromkeys(
                [*true, *(leg for g in ties if set(g) & set(true) for leg in g)]
            )
        )


def read(
    folder: Path, results: Path, oracles: Mapping[str, Mapping[str, Any]]
) -> list[Entry]:
    """Entries of all cases that have a result. Raises ValueError where results and set
    do not belong together.
    """
    made = some(folder, results, oracles)
    if not made:
        raise ValueError(
            f"{results}: there is no result of a case in {folder}; diagnose them first"
            " with `run`"
        )
    return made


def some(
    folder: Path, results: Path, oracles: Mapping[str, Mapping[str, Any]]
) -> list[Entry]:
    """Entries of those cases that have a result and figures of the oracle's, none
    maybe.
    """
    made = []
    for label in labels(folder):
        file = results / f"{label['id']}.json"
        if file.is_file() and label["id"] in oracles:
            made.append(entry(label, oracles[label["id"]], _json(file)))
    return made


def withheld(
    folder: Path, results: Path, oracles: Mapping[str, Mapping[str, Any]]
) -> list[tuple[str, Entry]]:
    """(effect withheld, entry) of all results for which the library was short of an
    effect that acts alone.
    """
    by_id = {label["id"]: label for label in labels(folder)}
    made = []
    for file in sorted((results / "without").glob("*/*.json")):
        label = by_id.get(file.stem)
        if (
            label is not None
            and file.stem in oracles
            and [e["name"] for e in label["effects"]] == [file.parent.name]
        ):
            made.append(
                (file.parent.name, entry(label, oracles[file.stem], _json(file)))
            )
    return made


def labels(folder: Path) -> list[dict[str, Any]]:
    """Labels of a set. Raises OSError."""
    text = (folder / "labels.jsonl").read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


def entry(
    label: Mapping[str, Any], oracle: Mapping[str, Any], result: Mapping[str, Any]
) -> Entry:
    """An entry; without `answers` the result is one of a failure."""
    answers = _answers(result.get("answers", []))
    methods: dict[str, Said | None] = {DIAGNOSIS: answers[0] if answers else None}
    for name in BASELINES:
        if name in result.get("baselines", {}):
            methods[name] = Said(tuple((n,) for n in result["baselines"][name]))
    return Entry(
        label, oracle, methods, answers, _answers(result.get("set95", [])), result
    )


def _answers(told: Sequence[Mapping[str, Any]]) -> tuple[Said, ...]:
    return tuple(judge.said(a) for a in told)


def _json(file: Path) -> dict[str, Any]:
    return dict(json.loads(file.read_text(encoding="utf-8")))
