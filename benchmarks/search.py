"""D-optimal plans of many kinds of candidates beside a plain NumPy exchange.

    python benchmarks/search.py                   # all instances, NumPy exchange of 100 starts
    python benchmarks/search.py --only normal     # instances whose name begins so
    python benchmarks/search.py --starts 0        # without the NumPy exchange
    python benchmarks/search.py --peers ENVS      # doetools too, on single rows

The best known value of an instance is the largest of this run: this project's choice at
its default, the same with `--rounds` rounds (300), and the others. Values are computed
from the chosen rows by one formula for all (`peers.py`). Seconds are
processor time on one thread; for this project the least of three runs, with the
relaxation and its bound. `benchmarks/design.py --install-peers ENVS` makes doetools'
environment.

Rows of `normal` are standard normal; `mixed` are normal rows times one random matrix;
`ill` have columns from 1 to 1.3e-6; `copies` are 500 rows four times over; `heavy` follow
Student's t with 2.5 degrees of freedom; `quadratic` is the full quadratic model on five
levels of five factors; `poses` are the blocks of `hexapod.py`. The last three
are candidates of studies (`study_candidates.py`).
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import argparse
import itertools
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import hexapod
import peer_runs
import peers
import study_candidates
from oed import design
from peers import processor_seconds

#: values that differ by less are equally good
EQUAL = 1e-6
#: runs of the default, of which the fastest counts: other processes slow a run down
REPEATS = 3
DEFAULT_ROUNDS = 20
COLUMNS = ("instance", "default", "s", "long run", "NumPy exchange", "s", "behind best")
WITH_PEERS = (*COLUMNS[:-1], "doetools", "s", COLUMNS[-1])


class Instance(NamedTuple):
    """Blocks (C, k, n) out of which `size` are chosen."""

    name: str
    blocks: np.ndarray
    size: int


def instances() -> Iterator[Instance]:
    """All instances."""
    for seed in range(100, 112):
        yield Instance(f"normal {seed}", _normal(seed, 2000, 21), 30)
    for seed in range(200, 203):
        yield Instance(f"few columns {seed}", _normal(seed, 5000, 10), 20)
    for seed in range(300, 303):
        rng = np.random.default_rng(seed)
        rows = rng.standard_normal((3000, 42)) @ rng.standard_normal((42, 42))
        yield Instance(f"mixed {seed}", rows[:, None], 60)
    for seed in range(400, 403):
        rows = _normal(seed, 2000, 21) * np.logspace(0.0, -5.9, 21)
        yield Instance(f"ill {seed}", rows, 30)
    for seed in range(500, 503):
        rows = np.repeat(_normal(seed, 500, 21), 4, axis=0)
        yield Instance(f"copies {seed}", rows, 30)
    for seed in range(600, 603):
        rng = np.random.default_rng(seed)
        yield Instance(f"heavy {seed}", rng.standard_t(2.5, (2000, 1, 21)), 30)
    yield Instance("quadratic", _quadratic(), 30)
    for number in range(3):
        yield Instance(f"poses {number}", hexapod.blocks(number), hexapod.SIZE)
    for name, blocks, size in study_candidates.of_studies():
        yield Instance(name, blocks, size)


def _normal(seed: int, count: int, columns: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, 1, columns))


def _quadratic() -> np.ndarray:
    levels = np.linspace(-1.0, 1.0, 5)
    x = np.array(list(itertools.product(levels, repeat=5)))
    pairs = itertools.combinations_with_replacement(range(5), 2)
    products = [x[:, i] * x[:, j] for i, j in pairs]
    return np.column_stack([np.ones(len(x)), x, *products])[:, None]


def choose(instance: Instance, rounds: int) -> tuple[float, float]:
    """Value and seconds of this project's choice."""
    start = processor_seconds()
    rng = np.random.default_rng(1)
    choice = design.choose(instance.blocks, instance.size, rng, rounds=rounds)
    seconds = processor_seconds() - start
    return peers.log_det(instance.blocks, choice.indices), seconds


def choose_by_numpy(instance: Instance, starts: int) -> tuple[float, float]:
    """Value and seconds of the NumPy exchange."""
    start = processor_seconds()
    rng = np.random.default_rng(1)
    chosen = peers.exchange(instance.blocks, instance.size, starts, rng)
    seconds = processor_seconds() - start
    return peers.log_det(instance.blocks, chosen), seconds


class Comparison(NamedTuple):
    """Values of one instance, and seconds; those of what did not run are infinite."""

    name: str
    value: float
    seconds: float
    long_value: float
    numpy_value: float
    numpy_seconds: float
    doetools_value: float
    doetools_seconds: float

    @property
    def behind(self) -> float:
        """How far the default is behind the best value."""
        others = (self.long_value, self.numpy_value, self.doetools_value)
        return max(self.value, *others) - self.value

    def row(self, with_peers: bool) -> str:
        """Its row of the table."""
        entries = [
            self.name,
            f"{self.value:.4f}",
            f"{self.seconds:.3f}",
            f"{self.long_value:.4f}",
            _entry(self.numpy_value, ".4f"),
            _entry(self.numpy_seconds, ".2f"),
        ]
        if with_peers:
            entries.append(_entry(self.doetools_value, ".4f"))
            entries.append(_entry(self.doetools_seconds, ".2f"))
        return _line([*entries, f"{self.behind:.4f}"])


def _line(entries: Sequence[str]) -> str:
    return f"| {' | '.join(entries)} |"


def _entry(number: float, digits: str) -> str:
    return format(number, digits) if np.isfinite(number) else "-"


def choose_by_doetools(instance: Instance, folder: Path | None) -> tuple[float, float]:
    """Value and seconds of doetools' exchange of single rows."""
    nothing = -np.inf, np.inf
    if folder is None or instance.blocks.shape[1] > 1:
        return nothing
    rows = instance.blocks[:, 0]
    answer = peer_runs.run_on_rows(folder, "doetools", rows, instance.size)
    if answer is None:
        return nothing
    indices, seconds = answer
    return peers.log_det(instance.blocks, indices), seconds


def compare(
    instance: Instance, rounds: int, starts: int, peers: Path | None
) -> Comparison:
    """All methods on one instance."""
    runs = [choose(instance, DEFAULT_ROUNDS) for _ in range(REPEATS)]
    long_value, _ = choose(instance, rounds)
    by_numpy = -np.inf, np.inf
    if starts:
        by_numpy = choose_by_numpy(instance, starts)
    by_doetools = choose_by_doetools(instance, peers)
    seconds = min(seconds for _, seconds in runs)
    value = runs[0][0]
    return Comparison(
        instance.name, value, seconds, long_value, *by_numpy, *by_doetools
    )


def main() -> None:
    """Print one row an instance, and what holds for all of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="beginning of the names")
    parser.add_argument("--rounds", type=int, default=300, help="of the long run")
    parser.add_argument("--starts", type=int, default=100, help="of the NumPy exchange")
    parser.add_argument("--peers", type=Path, help="folder of the environments")
    arguments = parser.parse_args()
    with_peers = arguments.peers is not None
    columns = WITH_PEERS if with_peers else COLUMNS
    print(_line(columns))
    print(_line(["---", *["--:"] * (len(columns) - 1)]))
    selected = [i for i in instances() if i.name.startswith(arguments.only)]
    comparisons = []
    for instance in selected:
        comparison = compare(
            instance, arguments.rounds, arguments.starts, arguments.peers
        )
        comparisons.append(comparison)
        print(comparison.row(with_peers))
        sys.stdout.flush()
    best = sum(c.behind < EQUAL for c in comparisons)
    print(f"best known at the default: {best} of {len(comparisons)}")
    others = {"the NumPy exchange": [c.numpy_value for c in comparisons]}
    if with_peers:
        others["doetools"] = [c.doetools_value for c in comparisons]
    for name, values in others.items():
        pairs = zip(comparisons, values, strict=True)
        behind = max(0.0, *(value - c.value for c, value in pairs))
        print(f"behind {name} by at most {behind:.4f}")


if __name__ == "__main__":
    main()
