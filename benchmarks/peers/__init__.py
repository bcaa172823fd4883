"""The two problems, and what an adapter of a peer says; NumPy only, since each peer
runs in its own environment.

Problem A: choose 30 of the 2000 x 21 rows of
`numpy.random.default_rng(0).standard_normal((2000, 21))`, none twice, for the largest
log det (D) or least eigenvalue (E) of their information matrix. Problem B: 30 runs of
20 factors in [-1, 1] and an intercept for the largest log det, points free.

An adapter is a file beside this one, named like the package. It holds `REQUIRES` (what
to install, pinned to what was measured; the first one's version is told), and `TASKS`.
A task prepares what is no part of the choice (imports, data in the package's own form)
and returns the choice as a function: `peers/__main__.py` times that alone.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

SIZE, COLUMNS, CANDIDATES = 30, 21, 2000
FACTORS = COLUMNS - 1

#: No 30 x 21 matrix of entries +1 and -1 has a larger log det of its information than
#: (n - 2)^(m - 2) (n - 2 + 2 s) (n - 2 + 2 (m - s)) with n = 30 runs, m = 21 columns, s
#: = 10 (Ehlich 1964, Math. Zeitschrift 84, 438-447; with fewer columns than runs Payne
#: 1974, Discrete Mathematics 10, 145-158). No matrix of entries between them has
#: either: the determinant is a sum of squared minors, convex in each entry.
BOUND_B = 19 * np.log(28.0) + np.log(48.0) + np.log(50.0)

Choice = Callable[[], Any]


class Task(NamedTuple):
    """One way of one package to solve one problem."""

    problem: str  #: "A, D", "A, E" or "B, D"
    method: str  #: in words, for the table
    prepare: Callable[
        ..., Choice
    ]  #: of the rows for A, of nothing for B; what it returns is timed
    note: str = ""  #: what it cannot do, or does otherwise than asked


def busy() -> float:
    """Processor seconds of this process and of those it started and waited for: others
    on the machine do not count.
    """
    waited = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + waited.ru_utime + waited.ru_stime


def candidates(count: int = CANDIDATES) -> np.ndarray:
    """Rows of problem A, (count, 21)."""
    return np.random.default_rng(0).standard_normal((count, COLUMNS))


def value(problem: str, found: Sequence[Any] | np.ndarray) -> tuple[float, str]:
    """Value of chosen row numbers (A) or of points (B), and what is wrong with them, if
    anything.
    """
    if problem.startswith("A"):
        chosen = np.asarray(found, dtype=int)
        repeats = len(chosen) - len(set(chosen.tolist()))
        matrix, count = candidates()[chosen], len(chosen)
        wrong = [f"{repeats} repeated"] if repeats else []
    else:
        points = np.asarray(found, dtype=float)
        matrix, count = np.column_stack([np.ones(len(points)), points]), len(points)
        wrong = ["outside the box"] if np.abs(points).max() > 1.0 + 1e-9 else []
    if count != SIZE:
        wrong.append(f"{count} runs")
    singular = np.linalg.svd(matrix, compute_uv=False)
    least = float(singular[-1] ** 2) if len(singular) == COLUMNS else 0.0
    if problem.endswith("E"):
        return least, ", ".join(wrong)
    return (
        2.0 * float(np.log(singular).sum()) if least > 1e-12 else -np.inf
    ), ", ".join(wrong)
