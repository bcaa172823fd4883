"""Plans of fresh instances beside a plain NumPy exchange of 60 starts, and a long run.

    python -m benchmarks.search                 # 36 instances, seeds drawn at run time
    python -m benchmarks.search --seed 7        # the instances of a printed seed
    python -m benchmarks.search --only ties near --each 8

The best known value of an instance is the best of this run: this project's choice at its
default, the same with ten times the rounds, and the NumPy exchange (`numpy_designs.py`: pairs
for D, each candidate in turn for blocks and for A and I). Values are computed from the chosen
rows by one formula for all; they are log det, or -log of the variance, so that a
difference is a relative one. Seconds are processor time on one thread; for this project
with the relaxation and its bound.

kinds
  A, I        30 of 2000 normal rows with 21 columns; I over 50 random poses of 3 components
  normal      the same by D
  mixed       60 of 3000 normal rows times one random matrix, 42 columns
  copies      30 of 500 normal rows with 21 columns, four times over
  heavy       30 of 2000 rows of Student's t with 2.5 degrees of freedom, 21 columns
  ties        27 of 1500 rows of -1, 0 and 1 with 25 columns
  near        27 of 1500 normal rows with 25 columns
  quadratic   28 to 33 of 4096: the full quadratic model on four levels of six factors
  blocks      7 to 9 of 1000 blocks of six normal rows with 42 columns
  poses       10 of 2000 poses of a hexapod (`hexapod.py`), six rows, 42 columns
  studies     candidates of three studies (`study_candidates.py`)
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks import hexapod, numpy_designs, study_candidates
from benchmarks.harness.tables import head, row
from benchmarks.peers import processor_seconds
from oed import design
from oed.design import CRITERIA

EQUAL = 1e-6  #: values that differ by less are equally good
DEFAULT_ROUNDS, LONG_FACTOR = 20, 10
STARTS = 60  #: random starts of the NumPy exchange
KINDS = [
    "A",
    "I",
    "normal",
    "mixed",
    "copies",
    "heavy",
    "ties",
    "near",
    "quadratic",
    "blocks",
    "poses",
    "studies",
]
COLUMNS = ("kind", "seed", "default", "s", "long run", "NumPy", "s", "behind best")


class Instance(NamedTuple):
    """Blocks (C, k, n) out of which `size` are chosen, by D, A or I."""

    kind: str
    blocks: np.ndarray
    size: int
    criterion: str = "D"
    accuracy: np.ndarray | None = None  #: (J, r, n) of I

    @property
    def weight(self) -> np.ndarray | None:
        """W (n, n) of tr(W M^-1); None for D."""
        if self.criterion == "A":
            return np.eye(self.blocks.shape[2])
        if self.accuracy is None:
            return None
        products = np.einsum("jrn,jrm->nm", self.accuracy, self.accuracy)
        return products / len(self.accuracy)

    def value(self, chosen: np.ndarray) -> float:
        """log det, or -log tr(W M^-1)."""
        if self.weight is None:
            return numpy_designs.log_det(self.blocks, chosen)
        rows = self.blocks[:, 0]
        return -float(np.log(numpy_designs.variance(rows, chosen, self.weight)))


def draw(kind: str, seed: int) -> Instance:
    """An instance of a kind of drawn candidates."""
    rng = np.random.default_rng(seed)
    if kind in ("A", "I", "normal"):
        rows = rng.standard_normal((2000, 1, 21))
        accuracy = rng.standard_normal((50, 3, 21)) if kind == "I" else None
        return Instance(kind, rows, 30, "D" if kind == "normal" else kind, accuracy)
    if kind == "mixed":
        rows = rng.standard_normal((3000, 42)) @ rng.standard_normal((42, 42))
        return Instance(kind, rows[:, None], 60)
    if kind == "copies":
        return Instance(
            kind, np.repeat(rng.standard_normal((500, 1, 21)), 4, axis=0), 30
        )
    if kind == "heavy":
        return Instance(kind, rng.standard_t(2.5, (2000, 1, 21)), 30)
    if kind == "ties":
        return Instance(kind, rng.integers(-1, 2, (1500, 1, 25)).astype(float), 27)
    if kind == "near":
        return Instance(kind, rng.standard_normal((1500, 1, 25)), 27)
    if kind == "quadratic":
        return Instance(kind, _quadratic(), int(rng.integers(28, 34)))
    if kind == "blocks":
        blocks = rng.standard_normal((1000, 6, 42))
        return Instance(kind, blocks, int(rng.integers(7, 10)))
    return Instance(kind, hexapod.blocks(seed), hexapod.SIZE)


def _quadratic() -> np.ndarray:
    x = np.array(list(itertools.product(np.linspace(-1.0, 1.0, 4), repeat=6)))
    pairs = itertools.combinations_with_replacement(range(6), 2)
    products = [x[:, i] * x[:, j] for i, j in pairs]
    return np.column_stack([np.ones(len(x)), x, *products])[:, None]


def instances(kinds: list[str], each: int, seed: int) -> Iterator[tuple[int, Instance]]:
    """So many instances of each kind with their seeds; the studies once."""
    for kind in kinds:
        if kind == "studies":
            for name, blocks, size in study_candidates.of_studies():
                yield 0, Instance(name, blocks, size)
            continue
        number = KINDS.index(kind)
        for drawn in np.random.SeedSequence([seed, number]).generate_state(each):
            yield int(drawn), draw(kind, int(drawn))


def choose(instance: Instance, rounds: int) -> tuple[float, float]:
    """Value and seconds of this project's choice."""
    columns = instance.blocks.shape[2]
    criterion = CRITERIA.build(instance.criterion, columns, instance.accuracy)
    start = processor_seconds()
    rng = np.random.default_rng(1)
    choice = design.choose(
        instance.blocks, instance.size, rng, criterion, rounds=rounds
    )
    seconds = processor_seconds() - start
    return instance.value(choice.indices), seconds


def choose_by_numpy(instance: Instance) -> tuple[float, float]:
    """Value and seconds of the NumPy exchange."""
    start = processor_seconds()
    rng = np.random.default_rng(1)
    chosen = numpy_designs.exchange(
        instance.blocks, instance.size, STARTS, rng, instance.weight
    )
    seconds = processor_seconds() - start
    return instance.value(chosen), seconds


class Comparison(NamedTuple):
    """Values of one instance, and seconds."""

    value: float
    seconds: float
    long_value: float
    numpy_value: float
    numpy_seconds: float

    @property
    def behind(self) -> float:
        """How far the default is behind the best value."""
        return max(self.value, self.long_value, self.numpy_value) - self.value

    def line(self, kind: str, seed: int) -> str:
        """Its line of the table."""
        values = (f"{self.value:.4f}", f"{self.seconds:.2f}", f"{self.long_value:.4f}")
        by_numpy = (f"{self.numpy_value:.4f}", f"{self.numpy_seconds:.2f}")
        return row(kind, seed, *values, *by_numpy, f"{self.behind:.4f}")


def compare(instance: Instance) -> Comparison:
    """All methods on one instance."""
    value, seconds = choose(instance, DEFAULT_ROUNDS)
    long_value, _ = choose(instance, LONG_FACTOR * DEFAULT_ROUNDS)
    return Comparison(value, seconds, long_value, *choose_by_numpy(instance))


def main() -> None:
    """Print one row an instance, and what holds for all of them."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    add = parser.add_argument
    add("--only", nargs="+", choices=KINDS, default=KINDS, help="these kinds")
    add("--each", type=int, default=3, help="instances of each kind")
    add("--seed", type=int, help="of the instances; drawn where it is left out")
    arguments = parser.parse_args()
    seed = arguments.seed
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}\n{head(*COLUMNS)}")
    comparisons = []
    for drawn, instance in instances(arguments.only, arguments.each, seed):
        comparisons.append(compare(instance))
        print(comparisons[-1].line(instance.kind, drawn), flush=True)
    _summarise(comparisons)


def _summarise(comparisons: list[Comparison]) -> None:
    behind = np.array([c.behind for c in comparisons])
    behind_numpy = np.array([c.numpy_value - c.value for c in comparisons])
    ratios = np.array([c.seconds / c.numpy_seconds for c in comparisons])
    count = len(comparisons)
    print(f"best known at the default: {(behind < EQUAL).sum()} of {count}")
    print(f"within 0.02 of the best known: {(behind < 0.02).sum()} of {count}")
    print(f"behind the best known by at most {behind.max():.4f}")
    print(f"behind the NumPy exchange: {(behind_numpy > EQUAL).sum()} of {count}")
    print(f"time over the NumPy exchange's: median {np.median(ratios):.2f}")


if __name__ == "__main__":
    main()
