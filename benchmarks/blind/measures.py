"""The measures of the benchmark, each with its count, its interval and what it must
reach.

What counts as what, where the wording leaves it open:

- detection counts cases of one known effect, whether these readings can test its name
  or not; severity is the oracle's sqrt(lambda) that the case was made for
- right class: one effect that the readings can test, at sqrt(lambda_k|j) >= 6 from
  every rival; the best answer names one effect, whose class holds the true one (an
  unknown remainder beside it is no fault)
- right class where the library's form shows it: those of these cases in which that form
  explains more than any rival's by sqrt(lambda) >= 6. In the others it is what no form
  of the library explains, the effect's own departure from it, that no rival takes over
- probability on the true class: the sum over all answers of that kind; one testable
  effect at sqrt(lambda) >= 6
- pairs: both effects testable, at sqrt(lambda) >= 6 beside each other and at
  sqrt(lambda_k|j) >= 6 from every rival; as few are, those of a set of pairs alone
  count with them where it is given (`score --pairs`)
- unknown flagged: `unknown` in the best answer, at sqrt(lambda) >= 6 beyond the best
  library effect
- called unknown alone: one testable known effect at sqrt(lambda) >= 6
- 95 % set: null cases, and cases whose effects are all testable (or unknown and out of
  the library's span) at sqrt(lambda) >= 6; it covers where one of its answers is right
  as a whole
- closure: the gain (S0 - S1) / S0 over the oracle's under the same noise law, readings
  and folds; 0 where the diagnosis adds nothing. Cases of known testable effects whose
  gain with the true law is expected to be at least 36
- place: for each kind of block that the label tells (leg, run, time) the likeliest
  claimed one, at sqrt(lambda) >= 6
- right leg where the library's form shows it: those of these cases in which some form
  of the library in the right leg alone explains more than any form in another leg
  alone, by sqrt(lambda) >= 6

A failed diagnosis is wrong in every count.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from benchmarks.blind import intervals, judge
from benchmarks.blind.entries import DIAGNOSIS, UNSEEN, Entry
from benchmarks.blind.judge import Said

SEEN, GAIN = 6.0, 36.0
#: severities in the labels are sizes wanted; those reached differ by less than this
#: share
TOLERANCE = 1e-3
PLACES = ("leg", "run", "time")
LAWS = ("white", "correlated", "heavy", "run", "combined")
RIGHT_CLASS = "right class at sqrt(lambda_k|j) >= 6"
LEVELS = (2.0, 4.0, 6.0, 10.0, 20.0)
Test = Callable[[Entry, Said | None], bool]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """A measure: its value with a 95 % interval over `count` cases; `hits` of them
    where it is a share.

    sense   `>=`, `<=`, or `in` for a band (must, aim);  "": told for what it is,
            without a target
    """

    key: str
    measure: str
    value: float
    low: float
    high: float
    count: int
    hits: int | None = None
    sense: str = ""
    must: float | None = None
    aim: float | None = None

    @property
    def status(self) -> str:
        """`aim`, `must` or `no` as the value reaches; `above` a band; `-` without cases
        or target.
        """
        if (
            not self.sense
            or self.must is None
            or self.aim is None
            or not self.count
            or math.isnan(self.value)
        ):
            return "-"
        if self.sense == "in":
            return (
                "no"
                if self.value < self.must
                else "above"
                if self.value > self.aim
                else "must"
            )
        sign = 1.0 if self.sense == ">=" else -1.0
        if sign * (self.value - self.aim) >= 0:
            return "aim"
        return "must" if sign * (self.value - self.must) >= 0 else "no"

    @property
    def proved(self) -> bool:
        """Whether what must be reached is, at the interval's worse end too."""
        if self.status not in ("aim", "must") or self.must is None:
            return False
        return self.high <= self.must if self.sense == "<=" else self.low >= self.must

    def told(self) -> dict[str, Any]:
        """As JSON and CSV take it."""
        said = dataclasses.asdict(self) | {"status": self.status, "proved": self.proved}
        return {
            k: None if isinstance(v, float) and not math.isfinite(v) else v
            for k, v in said.items()
        }


def share(key: str, measure: str, tests: Sequence[bool], **wanted: Any) -> Row:
    """A share of cases with Wilson's interval."""
    hits, count = sum(tests), len(tests)
    low, high = intervals.wilson(hits, count)
    value = hits / count if count else math.nan
    return Row(
        key=key,
        measure=measure,
        value=value,
        low=low,
        high=high,
        count=count,
        hits=hits,
        **wanted,
    )


def average(key: str, measure: str, values: Sequence[float], **wanted: Any) -> Row:
    """A mean."""
    value, low, high = intervals.mean(values)
    return Row(
        key=key,
        measure=measure,
        value=value,
        low=low,
        high=high,
        count=len(values),
        **wanted,
    )


def at_least(value: float, wanted: float) -> bool:
    """Whether a severity is reached, but for what the generator's search for it leaves."""
    return value >= wanted * (1.0 - TOLERANCE)


# -- which cases count -----------------------------------------------------------------


def singles(entries: Sequence[Entry]) -> list[Entry]:
    """Cases of one known effect."""
    return [e for e in entries if e.kind == "single"]


def plain(entries: Sequence[Entry]) -> list[Entry]:
    """Cases of one known effect that the readings can test, at sqrt(lambda) >= 6."""
    return [e for e in singles(entries) if e.testable and at_least(e.severity, SEEN)]


def told_apart(entries: Sequence[Entry]) -> list[Entry]:
    """Cases of one known effect that the readings can test and tell from every rival."""
    return [e for e in singles(entries) if e.testable and at_least(e.apart, SEEN)]


def pairs(entries: Sequence[Entry], *, apart: bool = True) -> list[Entry]:
    """Cases of two known effects, both to be seen (and told from every rival)."""
    some = [
        e
        for e in entries
        if e.kind == "pair" and e.testable and at_least(e.severity, SEEN)
    ]
    return [e for e in some if not apart or at_least(e.apart, SEEN)]


def strange(entries: Sequence[Entry]) -> list[Entry]:
    """Cases with an unknown effect outside the library's span."""
    return [e for e in entries if e.unknown and at_least(e.beyond, SEEN)]


def clear(entries: Sequence[Entry]) -> list[Entry]:
    """Cases whose truth can be seen: for the 95 % set."""
    kept = []
    for e in entries:
        known = e.testable and (not e.known or at_least(e.severity, SEEN))
        if e.kind == "null" or (known and (not e.unknown or at_least(e.beyond, SEEN))):
            kept.append(e)
    return kept


# -- tests of one answer ---------------------------------------------------------------


def alarm(e: Entry, a: Said | None) -> bool:
    """A gap is said where there is none."""
    return a is None or a.gap


def detected(e: Entry, a: Said | None) -> bool:
    """A gap is said."""
    return a is not None and a.gap


def right_class(e: Entry, a: Said | None) -> bool:
    """The true effects are named, and no other."""
    return a is not None and judge.exactly(a, e.known)


def flagged(e: Entry, a: Said | None) -> bool:
    """An unknown is said."""
    return a is not None and a.unknown


def unknown_alone(e: Entry, a: Said | None) -> bool:
    """Nothing but an unknown is said."""
    return a is None or (a.unknown and not a.classes)


def one_member(e: Entry, a: Said | None) -> bool:
    """One member of an exact class is named without the other."""
    members = set(e.label["class"])
    return a is None or any(
        members & set(c) and not members <= set(c) for c in a.classes
    )


def rightly(e: Entry, a: Said | None) -> bool:
    """A gap is said where there is one, and none where there is none."""
    return a is not None and a.gap == (e.kind != "null")


def _right(e: Entry, a: Said) -> bool:
    return judge.right(a, e.known, e.unknown)


def _tests(entries: Sequence[Entry], test: Test, method: str) -> list[bool]:
    return [test(e, e.said[method]) for e in entries if method in e.said]


# -- the table -------------------------------------------------------------------------


def rows(
    entries: Sequence[Entry], method: str = DIAGNOSIS, more: Sequence[Entry] = ()
) -> list[Row]:
    """The rows that every method has: from its best answer alone.

    more   pairs that can be told from every rival, of which a set has few; they count
           in the rows of such pairs alone
    """

    def told(
        key: str, measure: str, some: Sequence[Entry], test: Test, **wanted: Any
    ) -> Row:
        return share(key, measure, _tests(some, test, method), **wanted)

    known, new = (
        [e for e in entries if e.machine != UNSEEN],
        [e for e in entries if e.machine == UNSEEN],
    )
    one = singles(entries)
    made = []
    for law in LAWS:
        null = [e for e in entries if e.kind == "null" and e.law == law]
        made.append(
            told(
                f"alarm {law}",
                f"false alarm, {law} noise",
                null,
                alarm,
                **_most(0.05, 0.02),
            )
        )
    for level in LEVELS:
        some = [e for e in one if abs(e.severity - level) < 0.01 * level]
        made.append(
            told(
                f"found {level:g}",
                f"detection at sqrt(lambda) = {level:g}",
                some,
                detected,
            )
        )
    at6, at10 = (
        [e for e in one if abs(e.severity - 6.0) < 0.06],
        [e for e in one if at_least(e.severity, 10.0)],
    )
    exact = [e for e in entries if e.kind == "exact"]
    apart, new_apart, two = told_apart(known), told_apart(new), pairs([*entries, *more])
    member, new_name = (
        "exact-class case that names one member",
        f"the same on the unseen machine ({UNSEEN})",
    )
    made += [
        told(
            "detection 6",
            "detection at sqrt(lambda) 6",
            at6,
            detected,
            **_least(0.80, 0.90),
        ),
        told(
            "detection 10",
            "detection at 10 and more",
            at10,
            detected,
            **_least(0.97, 0.99),
        ),
        told("right class", RIGHT_CLASS, apart, right_class, **_least(0.90, 0.95)),
        told(
            "right class unseen", new_name, new_apart, right_class, **_least(0.85, 0.92)
        ),
        told(
            "pairs",
            "both of two effects exactly",
            two,
            right_class,
            **_least(0.75, 0.85),
        ),
        _false(
            two,
            method,
            "false effects pairs",
            "false effects a case of two",
            **_most(0.15, 0.05),
        ),
        told(
            "unknown",
            "unknown effect flagged",
            strange(entries),
            flagged,
            **_least(0.80, 0.90),
        ),
        told(
            "called unknown",
            "known called unknown alone",
            plain(entries),
            unknown_alone,
            **_most(0.05, 0.02),
        ),
        told("exact class", member, exact, one_member, **_most(0.02, 0.0)),
    ]
    return made + _more(entries, method)


def _least(must: float, aim: float) -> dict[str, Any]:
    return {"sense": ">=", "must": must, "aim": aim}


def _most(must: float, aim: float) -> dict[str, Any]:
    return {"sense": "<=", "must": must, "aim": aim}


def _more(entries: Sequence[Entry], method: str) -> list[Row]:
    """Rows without a target, that every method has."""

    def of(some: Sequence[Entry], test: Test) -> list[bool]:
        return _tests(some, test, method)

    blind = [
        e for e in singles(entries) if not e.testable and at_least(e.severity, SEEN)
    ]
    exact = [e for e in entries if e.kind == "exact" and at_least(e.severity, SEEN)]
    seen = [e for e in entries if e.unknown and at_least(e.severity, SEEN)]
    shown = [e for e in told_apart(entries) if at_least(e.shown, SEEN)]
    return [
        share(
            "right class shown",
            "right class where the library's form shows it, rivals' less",
            of(shown, right_class),
        ),
        share(
            "right class 6",
            "right class at sqrt(lambda) >= 6, rivals or not",
            of(plain(entries), right_class),
        ),
        share(
            "pairs 6",
            "both of two exactly, rivals or not",
            of(pairs(entries, apart=False), right_class),
        ),
        share(
            "exact found",
            "exact class named right, sqrt(lambda) >= 6",
            of(exact, right_class),
        ),
        share(
            "unknown 6",
            "unknown flagged, sqrt(lambda) >= 6, in the library's span or not",
            of(seen, flagged),
        ),
        share(
            "unknown found",
            "gap found where an unknown acts, sqrt(lambda) >= 6",
            of(seen, detected),
        ),
        _false(entries, method, "false effects", "false effects a case, all cases"),
        share(
            "untestable named",
            "name given to an effect that cannot be tested",
            of(blind, _named),
        ),
    ]


def _named(e: Entry, a: Said | None) -> bool:
    return a is None or bool(a.classes)


def _false(
    entries: Sequence[Entry], method: str, key: str, measure: str, **wanted: Any
) -> Row:
    """Mean number of effects named that do not act."""
    given = [(e, e.said[method]) for e in entries if method in e.said]
    return average(
        key,
        measure,
        [
            1.0 if a is None else float(judge.false_effects(a, e.known))
            for e, a in given
        ],
        **wanted,
    )


def own_rows(entries: Sequence[Entry]) -> list[Row]:
    """The rows that a diagnosis alone has: probabilities, sets, closure, place."""
    likely = [
        sum(a.probability for a in e.answers if judge.exactly(a, e.known))
        for e in plain(entries)
    ]
    named = [(e, e.said[DIAGNOSIS]) for e in told_apart(entries)]
    sizes = [
        float(len(a.classes[0]))
        for e, a in named
        if a is not None and judge.exactly(a, e.known)
    ]
    clearly = clear(entries)
    covered = [any(_right(e, a) for a in e.set95) for e in clearly]
    everything = [any(_right(e, a) for a in e.set95) for e in entries]
    kept = [float(len(e.set95)) for e in clearly]
    made = [
        average(
            "probability",
            "mean probability on the true class",
            likely,
            **_least(0.80, 0.90),
        ),
        average("class size", "mean size of a class that is right", sizes),
        share(
            "set95",
            "95 % answer set: coverage",
            covered,
            sense="in",
            must=0.93,
            aim=0.97,
        ),
        average("set95 size", "95 % answer set: mean size", kept, **_most(2.0, 1.5)),
        share(
            "set95 all",
            "95 % answer set: coverage, effects too small to be seen among them",
            everything,
        ),
    ]
    for split in ("within", "whole"):
        ratios = closure_ratios(entries, split)
        value, low, high = intervals.median(ratios)
        name = (
            "closure over the oracle's,"
            f" {'parts of runs' if split == 'within' else 'whole runs'}, median"
        )
        key, count = f"closure {split}", len(ratios)
        made.append(
            Row(
                key=key,
                measure=name,
                value=value,
                low=low,
                high=high,
                count=count,
                **_least(0.85, 0.95),
            )
        )
    return [*made, *place_rows(entries), *_leg_shown(entries)]


def _places(
    entries: Sequence[Entry], kinds: Sequence[str]
) -> Iterator[tuple[Entry, str, bool]]:
    """Each kind of block that the label of a case tells, and whether it is found; one
    effect at sqrt(lambda) >= 6.
    """
    for e in entries:
        if e.kind not in ("single", "unknown") or not at_least(e.severity, SEEN):
            continue
        for kind in kinds:
            if any(b.split(" ")[0] == kind for b in e.blocks):
                yield e, kind, judge.located(e.result.get("where", []), e.blocks, kind)


def _leg_shown(entries: Sequence[Entry]) -> list[Row]:
    """The leg, where readings and library tell it, and where they do not."""
    tests: dict[bool, list[bool]] = {True: [], False: []}
    for e, _, right in _places(entries, ("leg",)):
        tests[at_least(e.leg_shown, SEEN)].append(right)
    return [
        share(
            "leg shown",
            "right leg where the library's form shows it, other legs' less",
            tests[True],
        ),
        share("leg not shown", "right leg where it does not", tests[False]),
    ]


def place_rows(
    entries: Sequence[Entry], key: str = "place", prefix: str = ""
) -> list[Row]:
    """Where, over all kinds of blocks and for each; `prefix` is of the measures' names."""
    tests: dict[str, list[bool]] = {
        kind: [] for kind in (*PLACES, "direction", "phase")
    }
    seen: list[bool] = []
    for e, kind, right in _places(entries, tuple(tests)):
        tests[kind].append(right)
        if kind in PLACES and detected(e, e.said[DIAGNOSIS]):
            seen.append(right)
    together = [t for kind in PLACES for t in tests[kind]]
    made = [
        share(
            key, f"{prefix}right leg, run or time block", together, **_least(0.85, 0.95)
        ),
        share(
            f"{key} seen",
            f"{prefix}right leg, run or time block, where a gap is reported",
            seen,
        ),
    ]
    return made + [
        share(f"{key} {kind}", f"{prefix}right {kind}", told)
        for kind, told in tests.items()
    ]


def closure_ratios(entries: Sequence[Entry], split: str) -> list[float]:
    """Gain on held-out readings over the oracle's, case by case."""
    ratios = []
    for e in entries:
        if e.unknown or not e.testable or e.kind == "null":
            continue
        best = next((c for c in e.oracle["closure"] if c["split"] == split), None)
        if best is None or best["expected_gain"] < GAIN or best["same_law"] is None:
            continue
        most = _gain(best["same_law"])
        mine = next(
            (c for c in e.result.get("closure", []) if c["split"] == split), None
        )
        if most is not None and most > 0.0:
            ratios.append(((None if mine is None else _gain(mine)) or 0.0) / most)
    return ratios


def _gain(c: Any) -> float | None:
    """(S0 - S1) / S0."""
    if c["s0"] is None or c["s1"] is None or not c["s0"]:
        return None
    return float(1.0 - c["s1"] / c["s0"])


def withheld_rows(entries: Sequence[Entry]) -> list[Row]:
    """Rows of cases whose effect was withheld from the library, at sqrt(lambda_k|j) >=
    6 from all that are left.
    """
    some = [e for e in entries if at_least(e.apart, SEEN)]
    told = [e.said[DIAGNOSIS] for e in some]
    rest = [e.said[DIAGNOSIS] for e in entries if not at_least(e.apart, SEEN)]
    flags = [a is not None and a.unknown for a in told]
    alone = [a is not None and a.unknown and not a.classes for a in told]
    taken = [a is None or bool(a.classes) for a in rest]
    return [
        share(
            "withheld flagged",
            "withheld effect: unknown among the answer's effects",
            flags,
            **_least(0.80, 0.90),
        ),
        share("withheld alone", "withheld effect: unknown, and nothing else", alone),
        share(
            "withheld imitated",
            "withheld, below 6 from a rival: a known effect is named",
            taken,
        ),
        *place_rows(some, "withheld place", "withheld effect: "),
    ]


def reliability(entries: Sequence[Entry]) -> list[Row]:
    """How often the best answer is right, by the probability that it was given.

    Of cases whose truth can be seen, without the null cases, which are easy.
    """
    edges = (0.0, 0.5, 0.7, 0.9, 0.99, 1.0 + 1e-9)
    some = [e for e in clear(entries) if e.kind != "null"]
    told = [
        (a.probability, _right(e, a))
        for e in some
        if (a := e.said[DIAGNOSIS]) is not None
    ]
    made = []
    for low, high in itertools.pairwise(edges):
        name = f"best answer right, given {low:g} to {min(high, 1.0):g}"
        made.append(
            share(f"reliable {low:g}", name, [r for p, r in told if low <= p < high])
        )
    return made


# -- paired comparisons ----------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Paired:
    """Diagnosis and baseline on the same cases: only the one, only the other right;
    McNemar's exact p-value.
    """

    baseline: str
    measure: str
    count: int
    diagnosis: int
    other: int
    only_diagnosis: int
    only_other: int
    p_value: float

    @property
    def verdict(self) -> str:
        """Which is better at the 1 % level."""
        if self.p_value >= 0.01:
            return "no difference"
        return "diagnosis" if self.only_diagnosis > self.only_other else self.baseline


def compared(entries: Sequence[Entry], baseline: str) -> list[Paired]:
    """Every paired comparison with a baseline; `right` is the better answer in each."""
    null = [e for e in entries if e.kind == "null"]
    seen = [e for e in singles(entries) if at_least(e.severity, SEEN)]
    asked: list[tuple[str, list[Entry], Test]] = [
        ("no false alarm", null, lambda e, a: not alarm(e, a)),
        ("detection at sqrt(lambda) >= 6", seen, detected),
        ("gap or none, rightly", [*null, *seen], rightly),
        (RIGHT_CLASS, told_apart(entries), right_class),
        ("right class at sqrt(lambda) >= 6", plain(entries), right_class),
        (
            "both of two exactly, sqrt(lambda) >= 6",
            pairs(entries, apart=False),
            right_class,
        ),
    ]
    return [_pair(baseline, measure, some, test) for measure, some, test in asked]


def _pair(baseline: str, measure: str, entries: Sequence[Entry], test: Test) -> Paired:
    told = [
        (test(e, e.said[DIAGNOSIS]), test(e, e.said[baseline]))
        for e in entries
        if baseline in e.said
    ]
    mine, its = sum(a and not b for a, b in told), sum(b and not a for a, b in told)
    return Paired(
        baseline=baseline,
        measure=measure,
        count=len(told),
        diagnosis=sum(a for a, _ in told),
        other=sum(b for _, b in told),
        only_diagnosis=mine,
        only_other=its,
        p_value=intervals.mcnemar(mine, its),
    )
