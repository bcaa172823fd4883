"""Choosing 30 of C rows: value, bound and time, side by side with named alternatives in one run on one thread.

    python benchmarks/design.py            # problem A beside general solvers
    python benchmarks/design.py --large    # this project alone, up to 200,000 candidates, with its memory

Problem A: 30 of 2000 x 21 rows of `numpy.random.default_rng(0).standard_normal((2000, 21))`, no repeats. Times are
medians of three runs; ratios are to this project's relaxation, which certifies the bound.
"""

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy is loaded

import resource
import statistics
import sys
import time
from collections.abc import Callable

import cvxpy as cp
import numpy as np

from oed.design import e_relaxation, exchange, relaxation
from oed.design.blocks import as_blocks

SIZE, COLUMNS = 30, 21


def problem(count: int) -> np.ndarray:
    """Problem A with `count` candidates."""
    return np.random.default_rng(0).standard_normal((count, COLUMNS))


def timed(work: Callable[[], tuple[str, str]], repeats: int = 3) -> tuple[float, str, str]:
    """Median seconds, and what the last run told."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        told = work()
        times.append(time.perf_counter() - start)
    return statistics.median(times), *told


def relaxed(rows: np.ndarray) -> tuple[str, str]:
    """Our relaxation: value at its weights, certified bound."""
    found = relaxation.relax(rows, SIZE, tolerance=1e-7)
    return f"{found.value:.5f}", f"{found.bound:.5f} (gap {found.gap:.0e})"


def e_relaxed(rows: np.ndarray) -> tuple[str, str]:
    """The least eigenvalue's relaxation, its bound checked at the repaired dual."""
    found = e_relaxation.relax(rows, SIZE)
    return f"{found.value:.4f}", f"{found.bound:.5f} (gap {found.bound - found.value:.0e})"


def solver(rows: np.ndarray, name: str) -> tuple[str, str]:
    """The same relaxation by a general convex solver; its objective is no certificate."""
    w = cp.Variable(len(rows), nonneg=True)
    # one sparse product: far quicker to compile than a sum of matrices or diag(w)
    products = (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), -1)
    m = cp.reshape(products.T @ w, (COLUMNS, COLUMNS), order="C")
    cp.Problem(cp.Maximize(cp.log_det(m)), [cp.sum(w) == SIZE, w <= 1]).solve(solver=name)
    weights = np.clip(w.value, 0.0, 1.0)
    weights *= SIZE / weights.sum()
    value = float(np.linalg.slogdet((rows.T * weights) @ rows)[1])
    return f"{value:.5f}", "-"


def greedy(rows: np.ndarray) -> tuple[str, str]:
    """Greedy choice."""
    chosen = rows[exchange.greedy_d(as_blocks(rows), SIZE, np.zeros((COLUMNS, COLUMNS)))]
    return f"{float(np.linalg.slogdet(chosen.T @ chosen)[1]):.4f}", "-"


def chosen(rows: np.ndarray, criterion: str, starts: int) -> tuple[str, str]:
    """Our choice with its bound."""
    found = exchange.choose(rows, SIZE, np.random.default_rng(1), criterion, starts=starts, certify=criterion == "D")
    sure = "-" if found.bound is None else f"{found.bound:.5f} (certified {100 * found.efficiency:.1f} %)"
    return f"{found.value:.4f}", sure


def main() -> None:
    """Print one table."""
    rows = problem(2000)
    relaxed(rows)  # warm-up
    work: list[tuple[str, Callable[[], tuple[str, str]], int]] = [
        ("D relaxation, this project", lambda: relaxed(rows), 3),
        ("D relaxation, cvxpy + SCS", lambda: solver(rows, "SCS"), 1),
        ("D relaxation, cvxpy + Clarabel", lambda: solver(rows, "CLARABEL"), 1),
        ("D choice, greedy", lambda: greedy(rows), 3),
        ("D choice, this project, 10 rounds", lambda: chosen(rows, "D", 10), 3),
        ("D choice, this project, 100 rounds", lambda: chosen(rows, "D", 100), 3),
        ("E relaxation, this project", lambda: e_relaxed(rows), 1),
        ("E choice, this project, 3 rounds", lambda: chosen(rows, "E", 3), 3),
    ]
    if "--large" in sys.argv:
        del work[1:]
        for count in (20_000, 200_000):
            more = problem(count)
            work.append((f"D relaxation, {count} candidates", lambda more=more: relaxed(more), 3))
    first = None
    print(f"{'':38s} {'value':>10s} {'seconds':>9s} {'ratio':>8s}  bound")
    for name, run, repeats in work:
        seconds, value, bound = timed(run, repeats)
        first = seconds if first is None else first
        print(f"{name:38s} {value:>10s} {seconds:9.3f} {seconds / first:8.1f}  {bound}")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
