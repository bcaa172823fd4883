"""Mutate single lines of `oed`, and name the mutants that their room's tests miss.

    python -m benchmarks.mutants --seed 1
    python -m benchmarks.mutants --seed 1 --count 20 --rooms noise gap --out mutants.csv

Draws mutations over the rooms by their lines of code: a sign, a factor, an index, the
order of two arguments, a comparison, an extremum, a negation or a default changes. The
tests in tests/oed/<room> run against each, in a temporary copy of the tree. A mutant
is killed by a failure or by the time limit; those that survive are printed.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.mutants import trial
from benchmarks.mutants.draw import Mutant, draw, rooms_of

ROOT = Path(__file__).resolve().parents[2]
DETECTED = {trial.KILLED, trial.TIMED_OUT}
COLUMNS = ("room", "file", "line", "kind", "verdict", "before", "after")

Trial = tuple[Mutant, str]


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Exit code: 0 all mutants are killed, 1 some survive, 2 bad input."""
    rooms = rooms_of(root)
    parser = _parser(rooms)
    options = parser.parse_args(arguments)
    if options.out and options.out.exists():
        parser.error(f"--out {options.out} exists: name a new file or remove it.")
    rng = np.random.default_rng(options.seed)
    mutants = draw(root, options.rooms or rooms, options.count, rng)
    try:
        trials = list(_trials(root, mutants))
    except trial.FailingTestsError as error:
        parser.error(str(error))
    if options.out:
        _write(options.out, trials)
    _print_summary(trials)
    return int(any(verdict not in DETECTED for _, verdict in trials))


def _trials(root: Path, mutants: list[Mutant]) -> Iterator[Trial]:
    limits: dict[str, float] = {}
    with trial.copied(root) as tree:
        for mutant in mutants:
            verdict = trial.NO_TESTS
            if trial.has_tests(tree, mutant.room):
                if mutant.room not in limits:
                    limits[mutant.room] = trial.limit_of(tree, mutant.room)
                verdict = trial.verdict(tree, mutant, limits[mutant.room])
            _print_trial(mutant, verdict)
            yield mutant, verdict


def _print_trial(mutant: Mutant, verdict: str) -> None:
    mutation = mutant.mutation
    place = f"{mutant.path}:{mutation.line}"
    print(f"{verdict:10s}  {mutation.kind:10s}  {place}", flush=True)
    if verdict not in DETECTED:
        print(f"    - {mutation.before.strip()}", flush=True)
        print(f"    + {mutation.after.strip()}", flush=True)


def _print_summary(trials: list[Trial]) -> None:
    drawn = Counter(mutant.room for mutant, _ in trials)
    killed = Counter(mutant.room for mutant, v in trials if v in DETECTED)
    print(f"\n{'room':20s}{'mutants':>8s}{'survivors':>11s}")
    for room, number in sorted(drawn.items()):
        print(f"{room:20s}{number:8d}{number - killed[room]:11d}")
    print(f"{'all':20s}{drawn.total():8d}{drawn.total() - killed.total():11d}")


def _write(path: Path, trials: list[Trial]) -> None:
    with path.open("x", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for mutant, verdict in trials:
            m = mutant.mutation
            texts = (m.before.strip(), m.after.strip())
            row = (mutant.room, mutant.path, m.line, m.kind, verdict, *texts)
            writer.writerow(row)


def _parser(rooms: list[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.mutants",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=60, help="of mutants")
    parser.add_argument("--rooms", nargs="+", choices=rooms, metavar="ROOM")
    parser.add_argument("--out", type=Path, help="a table of all mutants (CSV)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
