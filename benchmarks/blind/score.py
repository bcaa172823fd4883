"""Score of a set's results; with `oracle` and `listing` the only part that opens labels.

    python -m benchmarks.blind score --cases SET --results RESULTS --out SCORE \\
        --table RESULTS.md

From nothing to that page, one command after the other (N: number of cases; a second
machine can take part by --dask):

    python -m benchmarks.blind generate --set blind --cases 1000 --seed N --out SET
    python -m benchmarks.blind run --cases SET --out RESULTS
    python -m benchmarks.blind list --cases SET --kinds single --least 6 --withhold \\
        --out WITHHELD
    python -m benchmarks.blind run --cases SET --out RESULTS --list WITHHELD
    python -m benchmarks.blind score --cases SET --results RESULTS --out SCORE \\
        --table RESULTS.md

and before the last, for a column of what an observer who knows the noise would find,
which takes about half as long as `run`,

    python -m benchmarks.blind known-noise --cases SET --results RESULTS

Few pairs of effects, one in ten, can be separated from every rival. More of them, for
the rows of such pairs alone, come by

    python -m benchmarks.blind generate --set blind --kinds pair --cases M --seed N \\
        --out PAIRS
    python -m benchmarks.blind list --cases PAIRS --least 6 --apart 6 --out LIST
    python -m benchmarks.blind run --cases PAIRS --out RESULTS --list LIST

and `score ... --pairs PAIRS`.

SCORE/ then holds rows.csv (every measure, for all cases, for each machine and for each
method), paired.csv, score.json, and confusion*.csv and .png. Needs the results of
`run`; RESULTS/oracle stores the oracle's figures.
"""

from __future__ import annotations

import collections
import dataclasses
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.blind import (
    checks,
    confusion,
    diagnosis_measures,
    entries,
    loading,
    measures,
    oracle,
    paired,
    selection,
    table,
)
from benchmarks.blind import known_noise as informed_observer
from benchmarks.blind.entries import BASELINES, DIAGNOSIS, Entry
from benchmarks.blind.paired import Paired
from benchmarks.blind.row import Row, share

#: name of the diagnosis with known noise among the methods
KNOWN_NOISE = "noise known"
#: key of the rows over all withheld effects
ALL = "all"


@dataclasses.dataclass(frozen=True)
class Score:
    """Everything that the page and the files report.

    entries     all cases
    rows        the diagnosis's rows over all cases
    methods     rows of each baseline, and of the diagnosis with known noise
    machines    the diagnosis's rows, machine by machine
    paired      comparisons with the baselines
    withheld    {effect: rows of results without it}, and over all such results
    about       counts of cases
    """

    entries: Sequence[Entry]
    rows: Sequence[Row]
    methods: Mapping[str, Sequence[Row]]
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
    report: Callable[[str], None] = print,
) -> Score:
    """Score a set's results, write the files, report the table.

    `pairs` is a set of which only the pairs count. Raises ValueError, OSError.
    """
    options: dict[str, Any] = {"workers": workers, "again": again, "report": report}
    figures = _figures(folder, results, **options)
    more = {} if pairs is None else _figures(pairs, results, **options)
    more = {name: f for name, f in more.items() if name not in figures}
    informed_results = results / informed_observer.FOLDER
    informed = informed_observer.figures(figures)
    more_informed = informed_observer.figures(more)
    other = pairs or folder
    scored = score(
        entries.read(folder, results, figures),
        entries.read_withheld(folder, results, figures),
        entries.read_available(folder, informed_results, informed),
        more=entries.read_available(other, results, more),
        more_informed=entries.read_available(other, informed_results, more_informed),
    )
    _write(scored, out)
    text = table.markdown(
        [*scored.rows, *scored.withheld.get(ALL, ())],
        scored.methods,
        scored.paired,
        scored.machines,
        scored.about,
    )
    if page is not None:
        loading.write(page, text)
    report(text)
    report(confusion.text(confusion.confusion(scored.entries)))
    return scored


def _figures(folder: Path, results: Path, **options: Any) -> dict[str, dict[str, Any]]:
    """The oracle's figures of the cases of a set that have a result, by id.

    Options are those of `oracle.run`.
    """
    for name in ("labels.jsonl", "manifest.jsonl"):
        if not (folder / name).is_file():
            raise ValueError(
                f"{folder}: there is no {name}; give the folder that `generate` wrote"
            )
    cases = [c for c in loading.manifest(folder) if _is_there(results, c.id)]
    acting = {}
    for label in entries.labels(folder):
        acting[label["id"]] = [e["name"] for e in label["effects"]]
    return oracle.run(folder, results, cases, acting, **options)


def _is_there(results: Path, name: str) -> bool:
    """Whether a case has a result, with the whole library or without an effect."""
    if (results / f"{name}.json").is_file():
        return True
    return any((results / "without").glob(f"*/{name}.json"))


def score(
    cases: Sequence[Entry],
    withheld: Sequence[tuple[str, Entry]] = (),
    informed: Sequence[Entry] = (),
    *,
    more: Sequence[Entry] = (),
    more_informed: Sequence[Entry] = (),
) -> Score:
    """All measures of some entries.

    withheld    (effect withheld, entry) of results without an effect
    informed    entries of the same cases by the observer who knows the noise
    more        pairs (see `rows` in `measures`)
    """
    baselines = [m for m in BASELINES if any(m in e.best for e in cases)]
    methods: dict[str, Sequence[Row]] = {}
    for method in baselines:
        methods[method] = measures.rows(cases, method, more)
    if informed:
        methods[KNOWN_NOISE] = [
            *measures.rows(informed, more=more_informed),
            *diagnosis_measures.diagnosis_rows(informed),
        ]
    machines = {}
    for machine in sorted({e.machine for e in cases}):
        more_of_machine = _of_machine(machine, more)
        machines[machine] = _machine_rows(_of_machine(machine, cases), more_of_machine)
    comparisons = [p for method in baselines for p in paired.compare(cases, method)]
    return Score(
        entries=cases,
        rows=[
            *measures.rows(cases, more=more),
            *diagnosis_measures.diagnosis_rows(cases),
            *diagnosis_measures.reliability(cases),
        ],
        methods=methods,
        machines=machines,
        paired=comparisons,
        withheld=_withheld_rows(withheld),
        about={
            "cases": len(cases),
            "failed": sum(e.best[DIAGNOSIS] is None for e in cases),
            "kinds": _counts(e.kind for e in cases),
            "machines": _counts(e.machine for e in cases),
            "withheld": len(withheld),
            "more": len(selection.pairs(more)),
        },
    )


def _counts(names: Iterable[str]) -> dict[str, int]:
    """How often each name comes, the most frequent first."""
    return dict(collections.Counter(names).most_common())


def _withheld_rows(withheld: Sequence[tuple[str, Entry]]) -> dict[str, Sequence[Row]]:
    """Rows of results without an effect: over all, and effect by effect."""
    if not withheld:
        return {}
    rows: dict[str, Sequence[Row]] = {}
    rows[ALL] = diagnosis_measures.withheld_rows([e for _, e in withheld])
    for effect in sorted({name for name, _ in withheld}):
        without = [e for name, e in withheld if name == effect]
        rows[effect] = diagnosis_measures.withheld_rows(without)
    return rows


def _of_machine(machine: str, cases: Sequence[Entry]) -> list[Entry]:
    return [e for e in cases if e.machine == machine]


def _machine_rows(cases: Sequence[Entry], more: Sequence[Entry]) -> list[Row]:
    """A machine's rows.

    The right class is of all its cases, developed on or not, and null cases of all
    noise laws are together.
    """
    null = [e for e in cases if e.kind == "null"]
    alarms = checks.check_all(null, checks.alarm, DIAGNOSIS)
    single = selection.separated_singles(cases)
    right = checks.check_all(single, checks.right_class, DIAGNOSIS)
    rows = [
        r
        for r in measures.rows(cases, more=more)
        if not r.key.startswith("right class") or r.key == "right class 6"
    ]
    return [
        share("alarm", "false alarm, all laws", alarms),
        share("right class", measures.RIGHT_CLASS, right),
        *rows,
        *diagnosis_measures.diagnosis_rows(cases),
    ]


def _as_csv(frame: pd.DataFrame, *, index: bool) -> str:
    return str(frame.to_csv(index=index, lineterminator="\n"))


def _write(scored: Score, out: Path) -> None:
    """Write all files of the score."""
    groups: dict[tuple[str, str], Sequence[Row]] = {(DIAGNOSIS, "all"): scored.rows}
    for method, rows in scored.methods.items():
        groups[method, "all"] = rows
    for machine, rows in scored.machines.items():
        groups[DIAGNOSIS, machine] = rows
    for effect, rows in scored.withheld.items():
        groups[DIAGNOSIS, f"without {effect}"] = rows
    records = []
    for (method, cases), rows in groups.items():
        group = {"method": method, "cases of": cases}
        records += [group | row.as_record() for row in rows]
    comparisons = []
    for pair in scored.paired:
        comparisons.append(dataclasses.asdict(pair) | {"better": pair.verdict})
    loading.write(out / "rows.csv", _as_csv(pd.DataFrame(records), index=False))
    loading.write(out / "paired.csv", _as_csv(pd.DataFrame(comparisons), index=False))
    matrices = {}
    for method in (DIAGNOSIS, *(m for m in scored.methods if m != KNOWN_NOISE)):
        matrix = confusion.confusion(scored.entries, method)
        name = "confusion" if method == DIAGNOSIS else f"confusion_{method}"
        matrices[method] = matrix.counts.to_dict(orient="index")
        loading.write(out / f"{name}.csv", _as_csv(matrix.counts, index=True))
        title = f"What acts and what was answered: {method}"
        confusion.picture(matrix, out / f"{name}.png", title)
    whole = {
        "about": scored.about,
        "rows": records,
        "paired": comparisons,
        "confusion": matrices,
    }
    loading.write(out / "score.json", json.dumps(whole, indent=1, default=int))
