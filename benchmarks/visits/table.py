"""Measures of second visits, as a table: what is right before and after, and as predicted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.intervals import wilson

Record = Mapping[str, Any]
#: bins of the predicted probability
BINS = ((0.0, 0.6), (0.6, 0.8), (0.8, 1.0))
HEADER = "| measure | first visit | after the second | bar |\n|---|---|---|---|"


def markdown(records: Sequence[Record]) -> str:
    """Shares before and after over all cases and over those visited; the calibration."""
    judged = [record for record in records if "failure" not in record]
    visited = [record for record in judged if record["visited"]]
    lines = [
        f"{len(records)} cases, {len(records) - len(judged)} left out,"
        f" {len(visited)} visited again with a share of readings of"
        f" {_readings(visited)}.",
        "",
        HEADER,
    ]
    for words, some in (("", judged), (", visited", visited)):
        lines += _rows(words, some)
    return "\n".join([*lines, "", *_calibration(visited)])


def _readings(visited: Sequence[Record]) -> str:
    shares = [record["further"] / record["readings"] for record in visited]
    return f"{np.mean(shares):.2f} (at most {max(shares):.2f})" if shares else "none"


def _rows(words: str, records: Sequence[Record]) -> list[str]:
    singles = [r for r in records if r["kind"] == "single"]
    clear = [r for r in singles if r["first"]["clear"]]
    pairs = [r for r in records if r["kind"] == "pair" and r["first"]["both_visible"]]
    unknown = [r for r in records if r["kind"] == "unknown"]
    return [
        _row(f"right class{words}", clear, lambda v: v["class"], "0.95"),
        _row(f"right class, all singles{words}", singles, lambda v: v["class"], ""),
        _row(f"both of two{words}", pairs, lambda v: v["right"], "0.80"),
        _row(f"never listed is flagged{words}", unknown, lambda v: v["right"], ""),
    ]


def _row(
    title: str,
    records: Sequence[Record],
    check: Callable[[Record], bool],
    bar: str,
) -> str:
    before = [check(r["first"]) for r in records]
    after = [check(_last(r)) for r in records]
    return f"| {title} | {_share(before)} | {_share(after)} | {bar} |"


def _last(record: Record) -> Record:
    """The answer that stands: of both visits, or of the first where none was advised."""
    answer: Record = record["second"] if record["visited"] else record["first"]
    return answer


def _share(values: Sequence[bool]) -> str:
    if not values:
        return "no case"
    low, high = wilson(sum(values), len(values))
    return f"{np.mean(values):.2f} ({low:.2f} to {high:.2f}), n {len(values)}"


def _calibration(visited: Sequence[Record]) -> list[str]:
    """Predicted probability that the likeliest answer is right, and the share that is."""
    lines = [
        "| predicted | cases | mean before | mean predicted | right before | right after |",
        "|---|---|---|---|---|---|",
    ]
    for low, high in (*BINS, (0.0, 1.0)):
        part = [r for r in visited if low <= r["predicted"] < high + (high == 1.0)]
        if part:
            lines.append(
                f"| {low:g} to {high:g} | {len(part)} | {_mean(part, 'now')}"
                f" | {_mean(part, 'predicted')} | {_right(part, 'first')}"
                f" | {_right(part, 'second')} |"
            )
    return lines


def _mean(records: Sequence[Record], name: str) -> str:
    return f"{np.mean([record[name] for record in records]):.2f}"


def _right(records: Sequence[Record], visit: str) -> str:
    return _share([record[visit]["likeliest_right"] for record in records])
