"""Problem A of the design benchmark, and the interface of an adapter to a package.

Only NumPy is imported here, because each package runs in an environment of its own.

Problem A: choose 30 different rows of the 2000 x 21 matrix
`numpy.random.default_rng(0).standard_normal((2000, 21))`. Maximise log det (D) or the
least eigenvalue (E) of their information matrix.

An adapter is a file in this folder with the package's name. It holds `REQUIRES`, the
pinned requirements (the first one is the package itself), and `TASKS`. A task prepares
what is not part of the choice: imports, and data in the package's format. It returns
the choice as a function, and `peers/__main__.py` times only that function.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

SIZE, COLUMNS, CANDIDATES = 30, 21, 2000
#: least eigenvalue below which the information matrix counts as singular
SINGULAR = 1e-12

Choose = Callable[[], Any]


class Task(NamedTuple):
    """One method of one package for one problem."""

    problem: str  #: "A, D" or "A, E"
    method: str  #: description for the table
    prepare: Callable[..., Choose]  #: takes the rows, returns the timed function
    note: str = ""  #: how its result differs from what the problem asks


def processor_seconds() -> float:
    """Processor time of this process and of its finished children.

    Other processes on the machine do not count. On Windows, children do not either.
    """
    try:
        import resource
    except ImportError:
        return time.process_time()
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def candidates(count: int = CANDIDATES) -> np.ndarray:
    """Rows of problem A, (count, 21)."""
    return np.random.default_rng(0).standard_normal((count, COLUMNS))


def value(problem: str, indices: Sequence[Any] | np.ndarray) -> tuple[float, str]:
    """Criterion value of the chosen row numbers, and the rules they break, if any."""
    chosen = np.asarray(indices, dtype=int)
    matrix = candidates()[chosen]
    singular_values = np.linalg.svd(matrix, compute_uv=False)
    complete = len(singular_values) == COLUMNS
    least = float(singular_values[-1] ** 2) if complete else 0.0
    violations = ", ".join(_violations(chosen))
    if problem.endswith("E"):
        return least, violations
    if least <= SINGULAR:
        return -np.inf, violations
    return 2.0 * float(np.log(singular_values).sum()), violations


def _violations(chosen: np.ndarray) -> list[str]:
    violations = []
    repeats = len(chosen) - len(set(chosen.tolist()))
    if repeats:
        violations.append(f"{repeats} repeated")
    if len(chosen) != SIZE:
        violations.append(f"{len(chosen)} runs")
    return violations
