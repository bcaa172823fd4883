"""The benchmark's result as Markdown, for docs/benchmarks/blind_results.md."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmarks.blind.measures import Paired, Row

#: measures without a unit of share: told as numbers
NUMBERS = ("false effects", "class size", "set95 size", "closure", "probability")
WORDS = {
    "aim": "aim reached",
    "must": "reached",
    "no": "**not reached**",
    "above": "above the band",
    "-": "",
}


def markdown(
    rows: Sequence[Row],
    beside: Mapping[str, Sequence[Row]],
    paired: Sequence[Paired],
    machines: Mapping[str, Sequence[Row]],
    about: Mapping[str, Any],
) -> str:
    """The whole page.

    rows      the diagnosis's, those with a target first;  beside: rows of each baseline
    paired    comparisons;  machines: rows of each machine's cases alone;  about: counts
              of cases, see `score`
    """
    parts = [
        (
            f"# Blind benchmark: {about['cases']} cases, {about['failed']} failed"
            " diagnoses"
        ),
        "",
        _by(about),
        "",
        (
            "`python -m benchmarks.blind score --cases SET --results RESULTS --table"
            " FILE` writes this page. Intervals: 95 %, Wilson for shares; proved: the"
            " interval's worse end reaches what must be. `benchmarks/blind/measures.py`"
            " defines what counts."
        ),
        "",
        *_main(rows, beside),
        "",
        "Without a target:",
        "",
        *_more(rows, beside),
        "",
        (
            "Diagnosis and baselines on the same cases (right answers; exact McNemar"
            " test; better at the 1 % level):"
        ),
        "",
        *_paired(paired),
        "",
        "By machine:",
        "",
        *_machines(machines),
    ]
    return "\n".join(parts) + "\n"


def _by(about: Mapping[str, Any]) -> str:
    kinds = ", ".join(f"{n} {k.replace('_', ' + ')}" for k, n in about["kinds"].items())
    machines = ", ".join(f"{m} {n}" for m, n in about["machines"].items())
    more = ""
    if about["more"]:
        more = (
            f" Beside them, {about['more']} pairs that can be distinguished from every rival,"
            " for the rows of such pairs alone."
        )
    return f"Cases by kind: {kinds}. By machine: {machines}.{more}"


def _main(rows: Sequence[Row], beside: Mapping[str, Sequence[Row]]) -> Iterable[str]:
    heads = [
        "measure",
        "result",
        "95 % interval",
        "cases",
        "must reach",
        "aim",
        "",
        *beside,
    ]
    yield _line(heads)
    yield _line(["---", *["--:"] * 5, "---", *["--:"] * len(beside)])
    for r in rows:
        if r.sense:
            must, aim = wanted(r)
            word = WORDS[r.status] + (", proved" if r.proved else "")
            yield _line(
                [
                    r.measure,
                    value(r),
                    interval(r),
                    count(r),
                    must,
                    aim,
                    word,
                    *_others(r, beside),
                ]
            )


def _more(rows: Sequence[Row], beside: Mapping[str, Sequence[Row]]) -> Iterable[str]:
    yield _line(["measure", "result", "95 % interval", "cases", *beside])
    yield _line(["---", *["--:"] * (3 + len(beside))])
    for r in rows:
        if not r.sense:
            yield _line(
                [r.measure, value(r), interval(r), count(r), *_others(r, beside)]
            )


def _others(row: Row, beside: Mapping[str, Sequence[Row]]) -> list[str]:
    """The same measure of what stands beside; nothing where that has not the same
    cases.
    """
    told = []
    for rows in beside.values():
        same = [r for r in rows if r.key == row.key and r.count == row.count]
        told.append(value(same[0]) if same else "")
    return told


def _paired(paired: Sequence[Paired]) -> Iterable[str]:
    yield _line(
        [
            "cases",
            "number",
            "baseline",
            "diagnosis right",
            "baseline right",
            "only one: d / b",
            "p",
            "better",
        ]
    )
    yield _line(["---", "--:", "---", "--:", "--:", "--:", "--:", "---"])
    for p in paired:
        only = f"{p.only_diagnosis} / {p.only_other}"
        told = f"{p.p_value:.1g}" if p.p_value < 0.01 else f"{p.p_value:.2f}"
        yield _line(
            [
                p.measure,
                str(p.count),
                p.baseline,
                str(p.diagnosis),
                str(p.other),
                only,
                told,
                p.verdict,
            ]
        )


def _machines(machines: Mapping[str, Sequence[Row]]) -> Iterable[str]:
    names = [
        "alarm",
        "detection 6",
        "detection 10",
        "right class",
        "right class 6",
        "probability",
    ]
    names += ["unknown", "pairs", "set95", "place"]
    first = {r.key: r for rows in machines.values() for r in rows}
    yield _line(["measure", *machines])
    yield _line(["---", *["--:"] * len(machines)])
    for name in names:
        if name in first:
            cells = []
            for rows in machines.values():
                r = next((r for r in rows if r.key == name), None)
                cells.append(
                    "" if r is None or not r.count else f"{value(r)} ({count(r)})"
                )
            yield _line([first[name].measure, *cells])


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


# -- numbers ---------------------------------------------------------------------------


def value(row: Row) -> str:
    """A row's value: per cent for shares, else a number; a dash without cases."""
    return _told(row, row.value) if row.count else "-"


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


def wanted(row: Row) -> tuple[str, str]:
    """What a row must reach, and its aim."""
    if row.must is None or row.aim is None:
        return "", ""
    if row.sense == "in":
        return f"{100 * row.must:g} to {100 * row.aim:g} %", ""
    sign = {">=": "≥", "<=": "≤"}[row.sense]
    return f"{sign} {_bound(row, row.must)}", f"{sign} {_bound(row, row.aim)}"


def _bound(row: Row, number: float) -> str:
    return (
        f"{number:.2f}"
        if row.hits is None and not _is_share(row)
        else f"{100 * number:g} %"
    )


def _told(row: Row, number: float) -> str:
    if math.isnan(number):
        return "-"
    return f"{100 * number:.1f} %" if _is_share(row) else f"{number:.2f}"


def _is_share(row: Row) -> bool:
    return not row.key.startswith(NUMBERS)
