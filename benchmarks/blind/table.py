"""Page of the benchmark's result as Markdown, for docs/benchmarks/blind_results.md."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks.blind.paired import SIGNIFICANT, Paired
from benchmarks.blind.row import Row

#: keys of measures that are numbers rather than shares
NUMBERS = ("false effects", "class size", "set95 size", "closure", "probability")
STATUS = {
    "aim": "aim reached",
    "must": "reached",
    "no": "**not reached**",
    "above": "above the band",
    "-": "",
}
#: keys of the rows by machine
BY_MACHINE = (
    "alarm",
    "detection 6",
    "detection 10",
    "right class",
    "right class 6",
    "probability",
    "unknown",
    "pairs",
    "set95",
    "place",
)
TARGET_HEADS = ("measure", "result", "95 % interval", "cases", "must reach", "aim", "")
PAIRED_HEADS = (
    "cases",
    "number",
    "baseline",
    "diagnosis right",
    "baseline right",
    "only one: d / b",
    "p",
    "better",
)

#: rows of other methods, by their names
Methods = Mapping[str, Sequence[Row]]


def markdown(
    rows: Sequence[Row],
    methods: Methods,
    paired: Sequence[Paired],
    machines: Mapping[str, Sequence[Row]],
    about: Mapping[str, Any],
) -> str:
    """The whole page.

    rows        the diagnosis's rows
    methods     rows of each baseline
    paired      comparisons
    machines    rows of each machine's cases alone
    about       counts of cases, see `score`
    """
    cases, failed = about["cases"], about["failed"]
    parts = [
        f"# Blind benchmark: {cases} cases, {failed} failed diagnoses",
        "",
        _counts(about),
        "",
        (
            "`python -m benchmarks.blind score --cases SET --results RESULTS --table"
            " FILE` writes this page. Intervals: 95 %, Wilson for shares; proved: the"
            " interval's worse end reaches what must be. `benchmarks/blind/measures.py`"
            " defines what counts."
        ),
        "",
        *_rows_with_target(rows, methods),
        "",
        "Without a target:",
        "",
        *_rows_without_target(rows, methods),
        "",
        (
            "Diagnosis and baselines on the same cases (right answers; exact McNemar"
            " test; better at the 1 % level):"
        ),
        "",
        *_paired_rows(paired),
        "",
        "By machine:",
        "",
        *_machine_rows(machines),
    ]
    return "\n".join(parts) + "\n"


def _counts(about: Mapping[str, Any]) -> str:
    """Counts of cases in a sentence."""
    kinds = [f"{n} {kind.replace('_', ' + ')}" for kind, n in about["kinds"].items()]
    machines = [f"{machine} {n}" for machine, n in about["machines"].items()]
    more = ""
    if about["more"]:
        more = (
            f" In addition, {about['more']} pairs that can be distinguished from every rival,"
            " for the rows of such pairs alone."
        )
    return (
        f"Cases by kind: {', '.join(kinds)}. By machine: {', '.join(machines)}.{more}"
    )


def _rows_with_target(rows: Sequence[Row], methods: Methods) -> Iterator[str]:
    yield _line([*TARGET_HEADS, *methods])
    yield _line(["---", *["--:"] * 5, "---", *["--:"] * len(methods)])
    for row in rows:
        if row.sense:
            must, aim = target(row)
            status = STATUS[row.status] + (", proved" if row.proved else "")
            yield _line([*_figures(row), must, aim, status, *_others(row, methods)])


def _rows_without_target(rows: Sequence[Row], methods: Methods) -> Iterator[str]:
    yield _line(["measure", "result", "95 % interval", "cases", *methods])
    yield _line(["---", *["--:"] * (3 + len(methods))])
    for row in rows:
        if not row.sense:
            yield _line([*_figures(row), *_others(row, methods)])


def _figures(row: Row) -> list[str]:
    return [row.measure, value(row), interval(row), count(row)]


def _others(row: Row, methods: Methods) -> list[str]:
    """The same measure of other methods; nothing where they lack the same cases."""
    cells = []
    for rows in methods.values():
        same = [r for r in rows if (r.key, r.count) == (row.key, row.count)]
        cells.append(value(same[0]) if same else "")
    return cells


def _paired_rows(paired: Sequence[Paired]) -> Iterator[str]:
    yield _line(PAIRED_HEADS)
    yield _line(["---", "--:", "---", "--:", "--:", "--:", "--:", "---"])
    for p in paired:
        digits = ".1g" if p.p_value < SIGNIFICANT else ".2f"
        yield _line(
            [
                p.measure,
                str(p.count),
                p.baseline,
                str(p.diagnosis),
                str(p.other),
                f"{p.only_diagnosis} / {p.only_other}",
                f"{p.p_value:{digits}}",
                p.verdict,
            ]
        )


def _machine_rows(machines: Mapping[str, Sequence[Row]]) -> Iterator[str]:
    by_machine = [{row.key: row for row in rows} for rows in machines.values()]
    yield _line(["measure", *machines])
    yield _line(["---", *["--:"] * len(machines)])
    for key in BY_MACHINE:
        rows = [by_key.get(key) for by_key in by_machine]
        measures = [row.measure for row in rows if row is not None]
        if measures:
            yield _line([measures[-1], *map(_cell, rows)])


def _cell(row: Row | None) -> str:
    """Value and cases of a machine's row, where it has any."""
    if row is None or not row.count:
        return ""
    return f"{value(row)} ({count(row)})"


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


# -- numbers ---------------------------------------------------------------------------


def value(row: Row) -> str:
    """A row's value: per cent for shares, else a number; a dash without cases."""
    return _in_words(row, row.value) if row.count else "-"


def interval(row: Row) -> str:
    """A row's interval."""
    if not row.count:
        return "-"
    if not (math.isfinite(row.low) and math.isfinite(row.high)):
        return "no bound"
    if row.hits is None:
        return f"{row.low:.2f} to {row.high:.2f}"
    return f"{100 * row.low:.1f} to {100 * row.high:.1f} %"


def count(row: Row) -> str:
    """A row's cases, hits first where it is a share."""
    return str(row.count) if row.hits is None else f"{row.hits}/{row.count}"


def target(row: Row) -> tuple[str, str]:
    """What a row must reach, and its aim."""
    if row.must is None or row.aim is None:
        return "", ""
    if row.sense == "in":
        return f"{100 * row.must:g} to {100 * row.aim:g} %", ""
    sign = {">=": "≥", "<=": "≤"}[row.sense]
    return f"{sign} {_bound(row, row.must)}", f"{sign} {_bound(row, row.aim)}"


def _bound(row: Row, number: float) -> str:
    if row.hits is None and not _is_share(row):
        return f"{number:.2f}"
    return f"{100 * number:g} %"


def _in_words(row: Row, number: float) -> str:
    if math.isnan(number):
        return "-"
    return f"{100 * number:.1f} %" if _is_share(row) else f"{number:.2f}"


def _is_share(row: Row) -> bool:
    return not row.key.startswith(NUMBERS)
