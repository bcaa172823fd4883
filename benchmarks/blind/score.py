"""Score the results of a set: the only part that opens labels and truth (with `oracle`
and `listing`).

    python -m benchmarks.blind score --cases SET --results RESULTS --out SCORE --table
    RESULTS.md

From nothing to that page, one line after the other (N: number of cases; a second
machine can take part by --dask):

    python -m benchmarks.blind generate --set blind --cases 1000 --seed N --out SET
    python -m benchmarks.blind run --cases SET --out RESULTS python -m benchmarks.blind
    list --cases SET --kinds single --least 6 --withhold --out WITHHELD python -m
    benchmarks.blind run --cases SET --out RESULTS --list WITHHELD python -m
    benchmarks.blind score --cases SET --results RESULTS --out SCORE --table RESULTS.md

and before the last, for a column of what who knows the noise would find, which takes
about half as long as `run`,

    python -m benchmarks.blind known-noise --cases SET --results RESULTS

Few pairs of effects can be told from every rival, one in ten; more of them, for the
rows of such pairs alone, by

    python -m benchmarks.blind generate --set blind --kinds pair --cases M --seed N
    --out PAIRS python -m benchmarks.blind list --cases PAIRS --least 6 --apart 6 --out
    TOLD python -m benchmarks.blind run --cases PAIRS --out RESULTS --list TOLD

and `score ... --pairs PAIRS`.

SCORE/ then holds rows.csv (every measure, for all cases, for each machine and for each
method), paired.csv, score.json, and confusion*.csv and .png. Needs the results of
`run`; the oracle's figures are kept in RESULTS/oracle.
"""

from __future__ import annotations

import collections
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.blind import (
    confusion,
    entries,
    knowing,
    loading,
    measures,
    oracle,
    table,
)
from benchmarks.blind.entries import BASELINES, DIAGNOSIS, Entry
from benchmarks.blind.measures import Paired, Row

#: the diagnosis by who knows the noise, among what stands beside it
KNOWING = "noise known"


@dataclasses.dataclass(frozen=True)
class Score:
    """Everything that the page and the files tell.

    rows      the diagnosis's over all cases;  machines: the same, machine by machine
    beside    each baseline's, and what they would be were the noise known
    paired    comparisons with the baselines;  withheld: (effect, cases, rows) of
              results without an effect
    """

    entries: Sequence[Entry]
    rows: Sequence[Row]
    beside: Mapping[str, Sequence[Row]]
    machines: Mapping[str, Sequence[Row]]
    paired: Sequence[Paired]
    withheld: Mapping[str, Sequence[Row]]
    about: Mapping[str, Any]


def run(
    folder: Path,
    results: Path,
    *,
    out: Path,
    page: Path | None = None,
    pairs: Path | None = None,
    workers: int = 0,
    again: bool = False,
    told: Callable[[str], None] = print,
) -> Score:
    """Score a set's results, write the files, print the table. `pairs`: a set of which
    only the pairs count.

    Raises ValueError, OSError.
    """
    options: dict[str, Any] = {"workers": workers, "again": again, "told": told}
    known = _figures(folder, results, **options)
    more = {} if pairs is None else _figures(pairs, results, **options)
    more = {n: f for n, f in more.items() if n not in known}
    informed, aware = results / knowing.FOLDER, knowing.figures(known)
    made = score(
        entries.read(folder, results, known),
        entries.withheld(folder, results, known),
        entries.some(folder, informed, aware),
        more=entries.some(pairs or folder, results, more),
        more_informed=entries.some(pairs or folder, informed, knowing.figures(more)),
    )
    _write(made, out)
    text = table.markdown(
        [*made.rows, *made.withheld.get("all", ())],
        made.beside,
        made.paired,
        made.machines,
        made.about,
    )
    if page is not None:
        loading.write(page, text)
    told(text)
    told(confusion.text(confusion.confusion(made.entries)))
    return made


def _figures(folder: Path, results: Path, **options: Any) -> dict[str, dict[str, Any]]:
    """The oracle's figures of the cases of a set that have a result, by id; options as
    `oracle.run` has them.
    """
    missing = [
        f for f in ("labels.jsonl", "manifest.jsonl") if not (folder / f).is_file()
    ]
    if missing:
        raise ValueError(
            f"{folder}: there is no {missing[0]}; give the folder that `generate` wrote"
        )
    cases = [c for c in loading.manifest(folder) if _is_there(results, c.id)]
    acting = {
        label["id"]: [e["name"] for e in label["effects"]]
        for label in entries.labels(folder)
    }
    return oracle.run(folder, results, cases, acting, **options)


def _is_there(results: Path, name: str) -> bool:
    return (results / f"{name}.json").is_file() or any(
        (results / "without").glob(f"*/{name}.json")
    )


def score(
    found: Sequence[Entry],
    withheld: Sequence[tuple[str, Entry]] = (),
    informed: Sequence[Entry] = (),
    *,
    more: Sequence[Entry] = (),
    more_informed: Sequence[Entry] = (),
) -> Score:
    """All measures of some entries; `informed`: of the same cases by who knows the
    noise; `more`: pairs (see `rows` in `measures`).
    """
    methods = [m for m in BASELINES if any(m in e.said for e in found)]
    rows = [
        *measures.rows(found, more=more),
        *measures.own_rows(found),
        *measures.reliability(found),
    ]
    machines = sorted({e.machine for e in found})
    beside: dict[str, Sequence[Row]] = {
        m: measures.rows(found, m, more) for m in methods
    }
    if informed:
        beside[KNOWING] = [
            *measures.rows(informed, more=more_informed),
            *measures.own_rows(informed),
        ]
    without: dict[str, Sequence[Row]] = {}
    if withheld:
        without["all"] = measures.withheld_rows([e for _, e in withheld])
        for name in sorted({n for n, _ in withheld}):
            without[name] = measures.withheld_rows(
                [e for n, e in withheld if n == name]
            )
    return Score(
        entries=found,
        rows=rows,
        beside=beside,
        machines={m: _of_machine(_of(m, found), _of(m, more)) for m in machines},
        paired=[p for m in methods for p in measures.compared(found, m)],
        withheld=without,
        about={
            "cases": len(found),
            "failed": sum(e.said[DIAGNOSIS] is None for e in found),
            "kinds": dict(collections.Counter(e.kind for e in found).most_common()),
            "machines": dict(
                collections.Counter(e.machine for e in found).most_common()
            ),
            "withheld": len(withheld),
            "more": len(measures.pairs(more)),
        },
    )


def _of(machine: str, some: Sequence[Entry]) -> list[Entry]:
    return [e for e in some if e.machine == machine]


def _of_machine(some: Sequence[Entry], more: Sequence[Entry]) -> list[Row]:
    """A machine's rows; there the right class is of its own cases, seen machine or not,
    and null cases are together.
    """
    null = [measures.alarm(e, e.said[DIAGNOSIS]) for e in some if e.kind == "null"]
    apart = [
        measures.right_class(e, e.said[DIAGNOSIS]) for e in measures.told_apart(some)
    ]
    rows = [
        r
        for r in measures.rows(some, more=more)
        if not r.key.startswith("right class") or r.key == "right class 6"
    ]
    return [
        measures.share("alarm", "false alarm, all laws", null),
        measures.share("right class", measures.RIGHT_CLASS, apart),
        *rows,
        *measures.own_rows(some),
    ]


def _write(made: Score, out: Path) -> None:
    groups: dict[tuple[str, str], Sequence[Row]] = {(DIAGNOSIS, "all"): made.rows}
    groups |= {(m, "all"): rows for m, rows in made.beside.items()}
    groups |= {(DIAGNOSIS, m): rows for m, rows in made.machines.items()}
    groups |= {(DIAGNOSIS, f"without {n}"): rows for n, rows in made.withheld.items()}
    flat = [
        {"method": m, "cases of": g} | r.told()
        for (m, g), rows in groups.items()
        for r in rows
    ]
    paired = [dataclasses.asdict(p) | {"better": p.verdict} for p in made.paired]
    loading.write(
        out / "rows.csv", pd.DataFrame(flat).to_csv(index=False, lineterminator="\n")
    )
    loading.write(
        out / "paired.csv",
        pd.DataFrame(paired).to_csv(index=False, lineterminator="\n"),
    )
    matrices = {}
    for method in (DIAGNOSIS, *(m for m in made.beside if m != KNOWING)):
        matrix = confusion.confusion(made.entries, method)
        name = "confusion" if method == DIAGNOSIS else f"confusion_{method}"
        matrices[method] = matrix.counts.to_dict(orient="index")
        loading.write(out / f"{name}.csv", matrix.counts.to_csv(lineterminator="\n"))
        confusion.picture(
            matrix, out / f"{name}.png", f"What acts and what was answered: {method}"
        )
    whole = {"about": made.about, "rows": flat, "paired": paired, "confusion": matrices}
    loading.write(out / "score.json", json.dumps(whole, indent=1, default=int))
