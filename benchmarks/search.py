"""D-optimal plans of many kinds of candidates beside a plain NumPy exchange.

    python benchmarks/search.py                   # all instances, NumPy exchange of 100 starts
    python benchmarks/search.py --only normal     # instances whose name begins so
    python benchmarks/search.py --starts 0        # without the NumPy exchange

The best known value of an instance is the largest of this run: this project's choice at
its default, the same with `--rounds` rounds (300), and the NumPy exchange. Values are
computed from the chosen rows by one formula for all (`peers/numpy_exchange.py`). Seconds
are processor time on one thread, with the relaxation and its bound for this project.

Rows of `normal` are standard normal; `mixed` are normal rows times one random matrix;
`ill` have columns from 1 to 1.3e-6; `copies` are 500 rows four times over; `heavy` follow
Student's t with 2.5 degrees of freedom; `quadratic` is the full quadratic model on five
levels of five factors; `poses` are the blocks of `hexapod.py`.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import argparse
import itertools
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

import hexapod
from oed.design import exchange
from oed.design.blocks import as_blocks
from peers import numpy_exchange, processor_seconds

#: values that differ by less are equally good
EQUAL = 1e-6


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
        yield Instance(f"mixed {seed}", as_blocks(rows), 60)
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


def _normal(seed: int, count: int, columns: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, 1, columns))


def _quadratic() -> np.ndarray:
    levels = np.linspace(-1.0, 1.0, 5)
    x = np.array(list(itertools.product(levels, repeat=5)))
    pairs = itertools.combinations_with_replacement(range(5), 2)
    products = [x[:, i] * x[:, j] for i, j in pairs]
    return as_blocks(np.column_stack([np.ones(len(x)), x, *products]))


def choose(instance: Instance, rounds: int) -> tuple[float, float]:
    """Value and seconds of this project's choice."""
    start = processor_seconds()
    rng = np.random.default_rng(1)
    choice = exchange.choose(instance.blocks, instance.size, rng, rounds=rounds)
    seconds = processor_seconds() - start
    return numpy_exchange.log_det(instance.blocks, choice.indices), seconds


def choose_by_numpy(instance: Instance, starts: int) -> tuple[float, float]:
    """Value and seconds of the NumPy exchange."""
    start = processor_seconds()
    rng = np.random.default_rng(1)
    chosen = numpy_exchange.exchange(instance.blocks, instance.size, starts, rng)
    seconds = processor_seconds() - start
    return numpy_exchange.log_det(instance.blocks, chosen), seconds


def main() -> None:
    """Print one row an instance, and what holds for all of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="beginning of the names")
    parser.add_argument("--rounds", type=int, default=300, help="of the long run")
    parser.add_argument("--starts", type=int, default=100, help="of the NumPy exchange")
    arguments = parser.parse_args()
    print("| instance | default | s | long run | NumPy exchange | s | behind best |")
    print("| --- | --: | --: | --: | --: | --: | --: |")
    selected = [i for i in instances() if i.name.startswith(arguments.only)]
    best_known, leads = [], []
    for instance in selected:
        value, seconds = choose(instance, 20)
        long_value, _ = choose(instance, arguments.rounds)
        other, other_seconds = -np.inf, 0.0
        if arguments.starts:
            other, other_seconds = choose_by_numpy(instance, arguments.starts)
        behind = max(value, long_value, other) - value
        best_known.append(behind < EQUAL)
        leads.append(value - other)
        print(
            f"| {instance.name} | {value:.4f} | {seconds:.3f} | {long_value:.4f} |"
            f" {other:.4f} | {other_seconds:.3f} | {behind:.4f} |"
        )
        sys.stdout.flush()
    print(f"best known at the default: {sum(best_known)} of {len(best_known)}")
    if arguments.starts:
        print(f"behind the NumPy exchange by at most {max(0.0, -min(leads)):.4f}")


if __name__ == "__main__":
    main()
