"""Entries of the scorer: of every case its label, the oracle's figures and the result."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind import judge
from benchmarks.blind.judge import StatedAnswer
from benchmarks.blind.results import Record

DIAGNOSIS, BASELINES = "diagnosis", ("harmonic", "stepwise")
#: machine that nobody who developed the diagnosis had
UNSEEN = "hexapod"
#: column of the readings that a kind of place needs
COLUMN_OF = {"time": "time_s", "direction": "direction"}


@dataclasses.dataclass(frozen=True)
class Entry:
    """A case and its answers.

    label      see `generator.cases.label`
    oracle     see `oracle`
    best       best answer of each method; None where the diagnosis failed
    answers    all of the diagnosis's answers
    set95      the answers of its 95 % set
    result     as written by `run`
    """

    label: Mapping[str, Any]
    oracle: Mapping[str, Any]
    best: Mapping[str, StatedAnswer | None]
    answers: tuple[StatedAnswer, ...]
    set95: tuple[StatedAnswer, ...]
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
        """sqrt(lambda) that the case was made for: the least of its effects.

        Each has the others in the model; 0 without any effect.
        """
        targets = [float(e["target"]) for e in self.label["effects"]]
        return min(targets, default=0.0)

    @property
    def testable(self) -> bool:
        """Whether these readings can test every known effect that acts."""
        return set(self.known) <= set(self.oracle["testable"])

    def _figures(self, *, unknown: bool) -> list[Mapping[str, Any]]:
        """The oracle's figures of the unknown effects, or of the known ones."""
        pairs = zip(self.label["effects"], self.oracle["effects"], strict=True)
        return [figures for e, figures in pairs if e["unknown"] == unknown]

    @property
    def separation(self) -> float:
        """Least sqrt(lambda_k|j) over known effects and their rivals; 0 without any."""
        figures = self._figures(unknown=False)
        return min((float(f["apart"]) for f in figures), default=0.0)

    @property
    def shown(self) -> float:
        """Least sqrt(lambda) that a known effect's library form explains beyond rivals'.

        0 where a rival's explains more.
        """
        margins = []
        for f in self._figures(unknown=False):
            margins.append(float(f["apart"]) ** 2 - float(f["own"]) ** 2)
        return math.sqrt(max(min(margins, default=0.0), 0.0))

    @property
    def leg_shown(self) -> float:
        """sqrt(lambda) that library forms in the true leg explain beyond other legs'.

        Of the only effect; 0 where a form in another leg explains more, or where the
        effect acts in none.
        """
        (effect,), (figures,) = self.label["effects"], self.oracle["effects"]
        remaining, whole = figures.get("legs", {}), float(effect["sqrt_lambda"])
        in_true_legs: list[float] = []
        in_others: list[float] = []
        for leg, value in remaining.items():
            group = in_true_legs if leg in self.blocks else in_others
            group.append(float(value))
        least = min(in_true_legs, default=whole)
        least_other = min(in_others, default=whole)
        return math.sqrt(max(least_other**2 - least**2, 0.0))

    @property
    def beyond(self) -> float:
        """sqrt(lambda) of the unknown effect beyond any library effect; 0 without any."""
        figures = self._figures(unknown=True)
        return max((float(f["beyond"]) for f in figures), default=0.0)

    @property
    def blocks(self) -> tuple[str, ...]:
        """Where the effects act, where that is in part.

        Without kinds whose column the readings lack; with legs in which the effects
        would make the same readings.
        """
        columns = self.label.get("columns", COLUMN_OF.values())
        missing = [kind for kind, c in COLUMN_OF.items() if c not in columns]
        true = []
        for e in self.label["effects"]:
            true += [b for b in e["blocks"] if b.split(" ")[0] not in missing]
        equivalent = []
        for figures in self.oracle["effects"]:
            for group in figures.get("tied", ()):
                if set(group) & set(true):
                    equivalent += group
        return tuple(dict.fromkeys([*true, *equivalent]))


def read(
    folder: Path,
    records: Mapping[str, Record],
    oracles: Mapping[str, Mapping[str, Any]],
) -> list[Entry]:
    """Entries of the cases of a set that have a record and the oracle's figures."""
    return [
        entry(label, oracles[name], records[name])
        for label in labels(folder)
        if (name := label["id"]) in records and name in oracles
    ]


def read_withheld(
    folder: Path,
    records: Mapping[str, Record],
    oracles: Mapping[str, Mapping[str, Any]],
) -> list[tuple[str, Entry]]:
    """(effect withheld, entry) of the records without the only effect that acts."""
    every = read(folder, records, oracles)
    acting = [[e["name"] for e in entry.label["effects"]] for entry in every]
    return [
        (entry.result["without"], entry)
        for entry, names in zip(every, acting, strict=True)
        if names == [entry.result["without"]]
    ]


def labels(folder: Path) -> list[dict[str, Any]]:
    """Labels of a set. Raises OSError."""
    text = (folder / "labels.jsonl").read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


def entry(
    label: Mapping[str, Any],
    oracle: Mapping[str, Any],
    result: Mapping[str, Any],
) -> Entry:
    """An entry; without `answers` the result is one of a failure."""
    answers = _parse(result.get("answers", []))
    best: dict[str, StatedAnswer | None] = {DIAGNOSIS: None}
    if answers:
        best[DIAGNOSIS] = answers[0]
    baselines = result.get("baselines", {})
    for method in BASELINES:
        if method in baselines:
            classes = tuple((name,) for name in baselines[method])
            best[method] = StatedAnswer(classes)
    set95 = _parse(result.get("set95", []))
    return Entry(label, oracle, best, answers, set95, result)


def _parse(answers: Sequence[Mapping[str, Any]]) -> tuple[StatedAnswer, ...]:
    return tuple(judge.parse_answer(a) for a in answers)
