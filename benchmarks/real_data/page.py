"""The board as a page: what was predicted blind, what others leave, where data are."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.real_data.run import Outcome, Row

HEAD = """\
# Real machines

What does a calibration predict of readings of a real machine that it did not see? This page is written by

```console
$ python -m benchmarks.real_data --data ../shared/data --out docs/benchmarks/real_data.md
```

No data are in the project: fetch them as the second table says, and name their folder. An entry whose data are absent
is left out. The studies `delta_v400`, `delta_v400_reverse`, `hangprinter_hp4` and `jugglebot` are shipped; the others
are what `oed import klipper` makes of a `printer.cfg`.

- *predicted*: rms of the held-out readings against the prediction; *inside*: share inside their 95 % intervals.
- *least squares*: what plain least squares of SciPy leaves of them, with the same parameters and no tolerances;
  *nominal*: what the nominal numbers leave. Unknowns of the held-out set-up itself, such as a probe's offset, are
  adjusted in all three.
- *needed*: readings, of all that were fitted, with which the prediction is within 10 % of that with all. A quarter, a
  half, three quarters and all of each set-up were tried.

| machine | fitted | predicted blind | readings | predicted | inside | least squares | nominal | needed |
|---|---|---|---|---|---|---|---|---|
"""
SOURCES = """
## Data

| machine | source and licence | fetch | fit |
|---|---|---|---|
"""


def markdown(outcomes: Sequence[Outcome]) -> str:
    """The whole page."""
    lines = [line for outcome in outcomes for line in _lines(outcome)]
    sources = [_source(outcome) for outcome in outcomes]
    return HEAD + "\n".join(lines) + "\n" + SOURCES + "\n".join(sources) + "\n"


def _lines(outcome: Outcome) -> list[str]:
    entry = outcome.entry
    if not outcome.rows:
        cells = [entry.name, entry.fitted, "nothing", *["–"] * 6]
        return [_joined(cells)]
    return [_joined(_cells(outcome, row)) for row in outcome.rows]


def _cells(outcome: Outcome, row: Row) -> list[str]:
    blind, entry = row.blind, outcome.entry
    return [
        entry.name,
        entry.fitted,
        f"{entry.blind}: {blind.name}, {blind.channel}",
        str(blind.n),
        f"{blind.rms:.3g} {blind.unit}",
        f"{100 * blind.coverage:.0f} %",
        f"{row.least_squares:.3g}",
        f"{row.nominal:.3g}",
        f"{row.needed} of {row.fitted}",
    ]


def _source(outcome: Outcome) -> str:
    entry, estimate = outcome.entry, outcome.result.estimate
    fit = ""
    if estimate is not None:
        fit = "; ".join(
            f"{channel} {rms:.3g} {estimate.units[channel]} rms"
            for channel, rms in estimate.rms_after.items()
        )
    return _joined([entry.name, entry.source, entry.fetch, fit])


def _joined(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
