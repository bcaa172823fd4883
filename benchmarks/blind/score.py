"""Score of the diagnoses; with `oracle` and `listing` the only part that opens labels.

    python -m benchmarks.blind score --folder out/blind

From nothing to that page, as `make blind` does it:

    python -m benchmarks.blind generate --set blind --cases 1000 --out out/blind/set
    python -m benchmarks.blind generate --set blind --kinds pair --cases 1000 \\
        --out out/blind/pairs
    python -m benchmarks.blind list --cases out/blind/set --kinds single --least 6 \\
        --withhold --out out/blind/withheld.jsonl
    python -m benchmarks.blind list --cases out/blind/pairs --least 6 --apart 6 \\
        --or-none --out out/blind/separated.jsonl
    PYTHONPATH=. oed campaign --allow-code benchmarks/blind.campaign.toml
    PYTHONPATH=. oed campaign --allow-code benchmarks/blind_known_noise.campaign.toml
    python -m benchmarks.blind score --folder out/blind

Few pairs of effects, one in ten, can be separated from every rival: more of them, for
the rows of such pairs alone, come from the set of pairs. The second campaign is for a
column of what an observer who knows the noise would find.

FOLDER/score then holds rows.csv (every measure, for all cases, for each machine and for
each method), paired.csv, score.json, and confusion*.csv and .png; FOLDER/oracle stores
the oracle's figures.
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
    results,
    selection,
    table,
)
from benchmarks.blind import known_noise as informed_observer
from benchmarks.blind.entries import BASELINES, DIAGNOSIS, Entry
from benchmarks.blind.paired import Paired
from benchmarks.blind.results import Record, Results
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
    known_noise: Path,
    *,
    page: Path,
    workers: int = 0,
    report: Callable[[str], None] = print,
) -> Score:
    """Score the diagnoses in `folder`, write the files, report the table.

    known_noise  folder of the campaign that knows the noise; may be missing
    page         Markdown file for the table

    Raises ValueError, OSError.
    """
    diagnoses, informed = results.read(folder), results.read(known_noise)
    if not diagnoses.every:
        raise ValueError(
            f"{folder}: there are no diagnoses; run `oed campaign"
            " benchmarks/blind.campaign.toml` first"
        )
    options: dict[str, Any] = {"workers": workers, "report": report}
    scored = _scored(folder, diagnoses, informed, options)
    _write(scored, folder / "score")
    text = table.markdown(
        [*scored.rows, *scored.withheld.get(ALL, ())],
        scored.methods,
        scored.paired,
        scored.machines,
        scored.about,
    )
    loading.write(page, text)
    report(text)
    report(confusion.text(confusion.confusion(scored.entries)))
    return scored


def _scored(
    folder: Path, diagnoses: Results, informed: Results, options: dict[str, Any]
) -> Score:
    """All measures of the diagnoses of both campaigns."""
    cases, pairs, store = folder / "set", folder / "pairs", folder / "oracle"
    figures = _figures(cases, diagnoses.every, store, options)
    more = {}
    if diagnoses.pairs:
        more = _figures(pairs, diagnoses.pairs, store, options)
    under_true_law = informed_observer.figures(figures)
    more_under_true_law = informed_observer.figures(more)
    other = pairs if more else cases
    return score(
        entries.read(cases, diagnoses.every, figures),
        entries.read_withheld(cases, diagnoses.withheld, figures),
        entries.read(cases, informed.every, under_true_law),
        more=entries.read(other, diagnoses.pairs, more),
        more_informed=entries.read(other, informed.pairs, more_under_true_law),
    )


def _figures(
    folder: Path,
    records: Mapping[str, Record],
    store: Path,
    options: dict[str, Any],
) -> dict[str, dict[str, Any]]:
    """The oracle's figures of the cases of a set that have a record, by id."""
    for name in ("labels.jsonl", "manifest.jsonl"):
        if not (folder / name).is_file():
            raise ValueError(f"{folder}: there is no {name}; `generate` writes it")
    acting = {}
    for label in entries.labels(folder):
        acting[label["id"]] = [e["name"] for e in label["effects"]]
    return oracle.run(folder, records, acting, store, **options)


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
