"""The judge of all worlds: measures of diagnoses, by the labels of their cases.

A label holds

    machine, kind, law   kind: null, single, pair, unknown (never listed), mixed (one
                         listed and one not), class (nothing tells its members apart), or
                         poor (a plan that lacks columns); law: {"law": name, ...}
    effects              of each that acts: effect; listed; sqrt_lambda; classes, names
                         that explain these readings as well as its own textbook form
                         does (None where it can hardly be seen); outside, the least that
                         others leave of it; out_of_span, the least that any leaves;
                         given_other, what the other one of a pair leaves; where: legs,
                         runs, time_s
    sqrt_lambda_total    of all that acts
    closure              for each split the closure C that whoever knows the shape
                         expects, and the gain; none where closures do not count

An effect counts as named where every name of the answer is in its class. Cases whose
severity can hardly be seen and poor designs count where a measure says so.
"""

from __future__ import annotations

import collections
import itertools
import re
import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.harness import tables
from benchmarks.harness.statistics import Measure, middle, share

UNKNOWN = "unknown"
Key = tuple[str, str]  #: machine and name of a case
#: sqrt(lambda) that counts as 6 and as 10 after the generator's search for a size
SIX, TEN = 5.9, 9.8
GAIN = 36.0  #: expected gain from which a closure is more than noise
TOO_WIDE = 1.5  #: least width of a time window's error, as a share of the true one
BINS = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  #: bins of the probability of the answer


class Scored:
    """A label with the diagnosis of its case."""

    def __init__(self, label: Mapping[str, Any], result: Mapping[str, Any]) -> None:
        self.label, self.result = label, result
        self.kind = label["kind"]
        self.effects = label["effects"]
        # an answer can name an effect; beside a listed one, others it cannot
        mixed = self.kind == "mixed"
        self.named = [e for e in self.effects if not mixed or e["listed"]]
        self.verdict = result.get("verdict", "none")
        self.answers = [
            (frozenset(a["effects"]), float(a["probability"]))
            for a in result.get("answers", [])
        ]
        self.first, self.probability = (
            self.answers[0] if self.answers else (frozenset(), 0.0)
        )
        self.names = self.first - {UNKNOWN}
        self.total = label.get("sqrt_lambda_total", 0.0)

    @property
    def detected(self) -> bool:
        """Whether a gap is reported."""
        return bool(self.verdict != "none")

    @property
    def classes(self) -> list[set[str]]:
        """For each acting effect that has a name, the names that are right."""
        return [set(e["classes"] or [e["effect"]]) for e in self.named]

    @property
    def is_clear(self) -> bool:
        """A single effect that these readings distinguish from all others."""
        if self.kind != "single":
            return False
        effect = self.effects[0]
        return bool(effect["classes"] and (effect["outside"] or 0.0) >= 6.0)

    @property
    def names_count(self) -> bool:
        """Whether the measures of names count the case: what acts shows, and apart."""
        if self.kind == "pair":
            return all(e.get("given_other", 0.0) >= SIX for e in self.effects)
        if self.kind == "unknown":
            return bool(self.effects[0]["out_of_span"] >= 6.0)
        return self.is_clear

    def names_are_right(self, names: frozenset[str]) -> bool:
        """Whether names stand for the acting effects, one each."""
        return len(names) == len(self.named) and all(
            names & members for members in self.classes
        )

    @property
    def is_right(self) -> bool:
        """Whether the first answer is right as a whole, a remainder counted as well."""
        if not self.effects:
            return not self.detected
        if self.kind == "unknown":
            return UNKNOWN in self.first
        return self.names_are_right(self.names)


def rows(scored: Sequence[Scored]) -> list[Measure]:
    """All measures."""
    full = [s for s in scored if s.kind != "poor"]
    return [
        *_alarms(scored),
        *_detection(full),
        *_names(full),
        *_coverage(full),
        *_closures(full),
        *_places(full),
        *_calibration(full),
    ]


def _alarms(scored: Sequence[Scored]) -> list[Measure]:
    clean = [s for s in scored if not s.effects]
    laws = sorted({s.label["law"]["law"] for s in clean})
    found = [_share("false alarm", clean, lambda s: s.detected)]
    for law in laws:
        of_law = [s for s in clean if s.label["law"]["law"] == law]
        found.append(_share(f"false alarm, {law} noise", of_law, lambda s: s.detected))
    return found


def _detection(full: Sequence[Scored]) -> list[Measure]:
    gaps = [s for s in full if s.effects and s.kind != "class"]
    rows_of = []
    for name, low, high in (("6", SIX, TEN), ("10 and more", TEN, 1e9)):
        among = [s for s in gaps if low <= s.total < high]
        title = f"detection at sqrt(lambda) {name}"
        rows_of.append(_share(title, among, lambda s: s.detected))
        for kind, words in (("single", "single"), ("unknown", "never listed")):
            part = [s for s in among if s.kind == kind]
            rows_of.append(_share(f"{title}, {words}", part, lambda s: s.detected))
    return rows_of


def _names(full: Sequence[Scored]) -> list[Measure]:
    clear = [s for s in full if s.is_clear]
    pairs = [s for s in full if s.kind == "pair" and s.names_count]
    outside = [s for s in full if s.kind == "unknown" and s.names_count]
    return [
        _share("right class", clear, _right_class),
        _share("both of two", pairs, lambda s: s.names_are_right(s.names)),
        _share("unknown flagged", outside, lambda s: UNKNOWN in s.first),
        _share("known called unknown", clear, lambda s: s.verdict == UNKNOWN),
    ]


def _right_class(s: Scored) -> bool:
    return s.detected and bool(s.names) and s.names <= s.classes[0]


def _coverage(full: Sequence[Scored]) -> list[Measure]:
    """Of the 95 % set: it holds the truth, a remainder aside where effects are named."""
    kinds = {
        "null": "no gap",
        "single": "single",
        "pair": "two",
        "unknown": "never listed",
    }
    rows_of = [
        _share("95 % set covers", [s for s in full if s.kind != "class"], _covers)
    ]
    for kind, words in kinds.items():
        part = [s for s in full if s.kind == kind]
        rows_of.append(_share(f"95 % set covers, {words}", part, _covers))
    return rows_of


def _covers(s: Scored) -> bool:
    members = [frozenset(a["effects"]) for a in s.result.get("set95", [])]
    if not s.effects:
        return frozenset() in members
    if s.total < SIX and frozenset() in members:
        return True  # a gap that cannot be seen leaves no gap possible
    if s.kind == "unknown":
        return any(UNKNOWN in m for m in members)
    return any(s.names_are_right(m - {UNKNOWN}) for m in members)


def _closures(full: Sequence[Scored]) -> list[Measure]:
    """Of the ratio to the closure that whoever knows the shape expects."""
    visible = [s for s in full if s.kind == "single" and s.total >= SIX]
    found = []
    for split in ("within", "whole"):
        ratios = []
        for s in visible:
            expected = s.label["closure"].get(split)
            if expected and expected["gain"] >= GAIN and expected["C"] > 0.0:
                ratios.append(_closure(s, split) / expected["C"])
        title = f"closure over the oracle's, {split}"
        found.append(middle(title, ratios))
    return found


def _closure(s: Scored, split: str) -> float:
    values = [c["value"] for c in s.result.get("closure", []) if c["split"] == split]
    return float(values[0] or 0.0) if values else 0.0


def _places(full: Sequence[Scored]) -> list[Measure]:
    """Of the first block that a diagnosis names and whose kind the label knows."""
    visible = [s for s in full if s.kind == "single" and s.total >= SIX and s.detected]
    judged = [_place(s) for s in visible]
    return [share("right place", [p for p in judged if p is not None])]


def _place(s: Scored) -> bool | None:
    for block in s.result.get("where", [])[:3]:
        right = _is_at(str(block["block"]), s)
        if right is not None:
            return right
    return None


def _is_at(block: str, s: Scored) -> bool | None:
    """Whether a block holds the truth; None where the label states none of its kind."""
    kind, _, where = block.partition(" ")
    places = [e["where"] for e in s.effects]
    numbers = [float(n) for n in re.findall(r"\d+(?:\.\d+)?", where)]
    if kind == "leg" and any("legs" in p for p in places):
        return any(int(numbers[0]) in p.get("legs", []) for p in places)
    if kind == "run" and numbers and any("runs" in p for p in places):
        return any(int(numbers[0]) in p.get("runs", []) for p in places)
    # a label has one window, or a list of them
    windows = [np.reshape(p.get("time_s", []), (-1, 2)) for p in places]
    if kind == "time" and sum(map(len, windows)) and len(numbers) == 2:
        low, high = numbers
        return any(
            low < end and high > start and high - low < TOO_WIDE * (end - start)
            for start, end in itertools.chain(*windows)
        )
    return None


def _calibration(full: Sequence[Scored]) -> list[Measure]:
    """Share of right answers by the probability that they were given with."""
    judged = [s for s in full if s.kind != "class" and s.answers]
    found = []
    for low, high in itertools.pairwise(BINS):
        part = [s for s in judged if low <= s.probability < high + 1e-9 * (high == 1)]
        title = f"answers of probability {low:g} to {high:g} that are right"
        found.append(_share(title, part, lambda s: s.is_right))
    return found


def _share(
    title: str, scored: Sequence[Scored], check: Callable[[Scored], bool]
) -> Measure:
    return share(title, [check(s) for s in scored])


# -- table -----------------------------------------------------------------------------
def table(rows_of: Sequence[Mapping[str, Any]]) -> str:
    """Measures of the rows of a campaign, a column an observer, and a line each effect.

    Only cases that were diagnosed by every observer of the campaign count. Raises
    ValueError without any.
    """
    by_observer: dict[str, dict[Key, Scored]] = {}
    for row in rows_of:
        key = row["label"]["machine"], row["case"]
        by_observer.setdefault(row["observer"], {})[key] = Scored(row["label"], row)
    first = next(iter(by_observer.values()), {})
    whole = [
        key for key in first if all(key in scored for scored in by_observer.values())
    ]
    if not whole:
        raise ValueError(
            "no case has a diagnosis by every observer: run the campaign first"
        )
    failed = sum("failure" in first[key].result for key in whole)
    seconds = statistics.median(first[key].result["cpu_s"] for key in whole)
    columns = [rows([scored[key] for key in whole]) for scored in by_observer.values()]
    lines = [
        f"{len(whole)} cases, {failed} of which the diagnosis could not read;"
        f" {seconds:.1f} s of processor time a case in the middle.",
        "",
        tables.head("measure", *by_observer),
    ]
    for measures in zip(*columns, strict=True):
        if any(m.count for m in measures):
            title = measures[0].title.replace("sqrt(lambda)", "$\\sqrt\\lambda$")
            lines.append(tables.row(title, *(m.cell for m in measures)))
    return "\n".join([*lines, "", *_by_effect([first[key] for key in whole])])


def _by_effect(scored: Sequence[Scored]) -> list[str]:
    """Single effects that can be seen: how many are detected, named, and as what."""
    groups: dict[tuple[bool, str], list[Scored]] = collections.defaultdict(list)
    for s in scored:
        if s.kind in ("single", "unknown") and s.total >= SIX:
            groups[s.kind == "unknown", s.effects[0]["effect"]].append(s)
    lines = [tables.head("effect", "cases", "detected", "right", "other answers")]
    for (never_listed, name), group in sorted(groups.items()):
        right = [s for s in group if _is_named(s)]
        others = collections.Counter(
            " + ".join(sorted(s.first)) or s.verdict for s in group if s not in right
        )
        words = ", ".join(f"{what} {n}" for what, n in others.most_common())
        detected = sum(s.detected for s in group)
        title = f"{name} (never listed)" if never_listed else name
        lines.append(tables.row(title, len(group), detected, len(right), words or "-"))
    return lines


def _is_named(s: Scored) -> bool:
    return UNKNOWN in s.first if s.kind == "unknown" else _right_class(s)
