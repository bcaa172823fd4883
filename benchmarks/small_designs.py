"""E and kappa where plans are few: all plans beside the search, and a loop in NumPy.

    python -m benchmarks.small_designs

Twenty instances of 5 of 11 normal rows with 3 columns. The search is the one of larger
problems, 20 rounds; the loop takes each subset's eigenvalues by itself. Seconds are
processor seconds on one thread, medians; `best` counts instances with the value of the
loop.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import itertools
import statistics
import time
from collections.abc import Callable
from unittest import mock

import numpy as np

from oed.design import choose, exchange

SIZE, ROWS, COLUMNS, INSTANCES = 5, 11, 3, 20


def loop(rows: np.ndarray, criterion: str) -> float:
    """Value of the best subset, one after the other."""
    best = -np.inf
    for chosen in itertools.combinations(range(len(rows)), SIZE):
        part = rows[list(chosen)]
        values = np.linalg.eigvalsh(part.T @ part)
        value = values[0] if criterion == "E" else values[0] / values[-1]
        best = max(best, float(value))
    return best if criterion == "E" else float(np.sqrt(1.0 / best))


def by_plans(rows: np.ndarray, criterion: str) -> float:
    """The value of the program's choice."""
    return choose(rows, SIZE, np.random.default_rng(0), criterion).value


def by_search(rows: np.ndarray, criterion: str) -> float:
    """The same without a look at all plans."""
    with mock.patch.object(exchange, "best_of_all", return_value=None):
        return by_plans(rows, criterion)


def measure(
    method: Callable[[np.ndarray, str], float], criterion: str
) -> tuple[list[float], float]:
    """Values of the instances, and median seconds."""
    values, seconds = [], []
    for seed in range(INSTANCES):
        rows = np.random.default_rng(seed).standard_normal((ROWS, COLUMNS))
        start = time.process_time()
        values.append(method(rows, criterion))
        seconds.append(time.process_time() - start)
    return values, statistics.median(seconds)


def main() -> None:
    """Print the table."""
    print("| criterion | method | best | s | over all plans |")
    print("| --- | --- | --: | --: | --: |")
    for criterion in ("E", "kappa"):
        reference = measure(loop, criterion)
        ours = measure(by_plans, criterion)
        rows = {
            "all plans": ours,
            "search": measure(by_search, criterion),
            "loop in NumPy": reference,
        }
        for name, (values, seconds) in rows.items():
            best = int(np.isclose(values, reference[0], rtol=1e-9).sum())
            ratio = seconds / ours[1]
            print(
                f"| {criterion} | {name} | {best}/{INSTANCES} | {seconds:.4f} | {ratio:.1f} |"
            )


if __name__ == "__main__":
    main()
