"""Measures of the places that a diagnosis names: legs, runs, times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.blind import judge
from benchmarks.blind.checks import detected
from benchmarks.blind.entries import DIAGNOSIS, Entry
from benchmarks.blind.row import Row, at_least, share
from benchmarks.blind.selection import VISIBLE, reaches, visible

#: kinds of blocks that count together, and further ones
PLACES, FURTHER = ("leg", "run", "time"), ("direction", "phase")


def _places(
    entries: Sequence[Entry],
    kinds: Sequence[str],
) -> Iterator[tuple[Entry, str, bool]]:
    """Each kind of block that a case's label states, and whether it is found.

    Cases of one effect at sqrt(lambda) >= 6.
    """
    for e in entries:
        if e.kind not in ("single", "unknown") or not visible(e):
            continue
        stated = {block.split(" ")[0] for block in e.blocks}
        where = e.result.get("where", [])
        for kind in kinds:
            if kind in stated:
                yield e, kind, judge.located(where, e.blocks, kind)


def leg_rows(entries: Sequence[Entry]) -> list[Row]:
    """The leg, where readings and library determine it, and where they do not."""
    tests: dict[bool, list[bool]] = {True: [], False: []}
    for e, _, right in _places(entries, ("leg",)):
        tests[reaches(e.leg_shown, VISIBLE)].append(right)
    return [
        share(
            "leg shown",
            "right leg where the library's form shows it, other legs' less",
            tests[True],
        ),
        share("leg not shown", "right leg where it does not", tests[False]),
    ]


def place_rows(
    entries: Sequence[Entry],
    key: str = "place",
    prefix: str = "",
) -> list[Row]:
    """The place, over all kinds of blocks and for each.

    `prefix` is of the measures' names.
    """
    tests: dict[str, list[bool]] = {kind: [] for kind in (*PLACES, *FURTHER)}
    with_gap: list[bool] = []
    for e, kind, right in _places(entries, tuple(tests)):
        tests[kind].append(right)
        if kind in PLACES and detected(e, e.best[DIAGNOSIS]):
            with_gap.append(right)
    together = [right for kind in PLACES for right in tests[kind]]
    measure = f"{prefix}right leg, run or time block"
    by_kind = [
        share(f"{key} {kind}", f"{prefix}right {kind}", rights)
        for kind, rights in tests.items()
    ]
    return [
        share(key, measure, together, **at_least(0.85, 0.95)),
        share(f"{key} seen", f"{measure}, where a gap is reported", with_gap),
        *by_kind,
    ]
