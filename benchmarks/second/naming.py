"""How well can anybody name what acts on the second generator, the noise law unknown?

    python -m benchmarks.second.naming run --seed 20261126 --cases 80 --out out/naming.jsonl
    python -m benchmarks.second.naming table out/naming.jsonl

The first command draws the cases of four machines again, as `python -m benchmarks.second
generate` does with the same seed and number, and lets the observer of `names.py` name
what acts in those that the measures of names count. The second prints how often it is right.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from benchmarks.blind import row
from benchmarks.exit_code import exit_code
from benchmarks.second import names, noise_laws, observers, recorded
from benchmarks.second.ideal import GAUSSIAN, SIZES
from benchmarks.second.names import Frequencies, Names
from benchmarks.second.replay import Generator, Replay
from benchmarks.second.score import UNKNOWN, Scored
from benchmarks.second.table import cell

#: kinds of cases, and what is counted of each
MEASURES = {
    "single": "right class",
    "pair": "both of two",
    "unknown": "unknown flagged",
}
#: what the observer knows of the noise laws
GENERATORS, USUAL = "the generator's laws", "usual laws"


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 2 bad input."""
    return exit_code(recorded.parser("naming", __doc__, _run, _table), arguments)


def _run(options: argparse.Namespace) -> int:
    return recorded.record_cases(options, MEASURES, _record)


def _record(
    generator: Generator, replay: Replay, machine: str, rng: np.random.Generator
) -> dict[str, Any] | None:
    """The likeliest names under each prior of laws, and whether they are right."""
    case = Scored(replay.label, {})
    if not case.names_count:
        return None
    itself = (replay.readings - replay.case.y) / replay.sigma
    itself += replay.slopes @ rng.standard_normal(replay.slopes.shape[1])
    drawn = observers.draw_effects(generator, replay, machine, rng)
    often = frequencies(generator, machine)
    record: dict[str, Any] = {
        "kind": case.kind,
        "law": replay.label["law"]["law"],
        "effects": [e["effect"] for e in case.effects],
    }
    grids = {GENERATORS: noise_laws.laws()}
    if record["law"] in GAUSSIAN:
        grids[USUAL] = noise_laws.usual_laws()
    for words, grid in grids.items():
        (posterior,) = names.log_posterior(
            replay, itself[:, None], drawn, often, SIZES, grid
        )
        likeliest, probability = _likeliest(posterior, often)
        record[words] = {
            "names": sorted(likeliest),
            "probability": round(probability, 4),
            "right": is_right(case, likeliest),
        }
    return record


def frequencies(generator: Generator, machine: str) -> Frequencies:
    """How often the generator draws each set of names for a machine."""
    mix: Mapping[str, float] = generator.make.MIX
    total = mix["null"] + sum(mix[kind] for kind in MEASURES)
    listed = tuple(
        name
        for name, (_, machines) in generator.effects.LISTED.items()
        if machine in machines
    )
    gaps = (mix["single"] + mix["unknown"]) / total
    single = {name: gaps * p for name, p in generator.names(machine).items()}
    pairs = 0.5 * len(listed) * (len(listed) - 1)
    return Frequencies(mix["null"] / total, single, mix["pair"] / total / pairs, listed)


def _likeliest(
    posterior: Mapping[Names, float], often: Frequencies
) -> tuple[Names, float]:
    """The likeliest set, of which whatever is not listed is one name, and its share."""
    norm = special.logsumexp(list(posterior.values()))
    shares: dict[Names, float] = {}
    for acting, value in posterior.items():
        key = frozenset(n if n in often.listed else UNKNOWN for n in acting)
        shares[key] = shares.get(key, 0.0) + float(np.exp(value - norm))
    best = max(shares, key=lambda key: shares[key])
    return best, shares[best]


def is_right(case: Scored, likeliest: Names) -> bool:
    """As the measures of names count."""
    if case.kind == "unknown":
        return UNKNOWN in likeliest
    if case.kind == "pair":
        return case.names_are_right(likeliest)
    return bool(likeliest) and likeliest <= case.classes[0]


def _table(options: argparse.Namespace) -> int:
    return recorded.print_table(options, table)


def table(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Share of right answers by kind: of all cases, and of those with Gaussian noise."""
    gaussian = [r for r in records if r["law"] in GAUSSIAN]
    columns = (
        (GENERATORS, GENERATORS, records),
        (f"{GENERATORS}, Gaussian noise", GENERATORS, gaussian),
        (f"{USUAL}, Gaussian noise", USUAL, gaussian),
    )
    header = " | ".join(["measure", *(words for words, _, _ in columns)])
    lines = [f"| {header} |", "|---" * (1 + len(columns)) + "|"]
    for kind, measure in MEASURES.items():
        cells = [measure]
        for _, prior, part in columns:
            right = [bool(r[prior]["right"]) for r in part if r["kind"] == kind]
            cells.append(cell(row.share(measure, measure, right)))
        lines.append("| " + " | ".join(cells) + " |")
    return lines


if __name__ == "__main__":
    sys.exit(main())
