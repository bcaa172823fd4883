"""pyDOE3: polynomial models in factors; the 21 columns are factors plus an intercept."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("pydoe3==1.6.2",)


def optimal(rows: np.ndarray, criterion: str, method: str) -> Choose:
    """Its `optimal_design` of degree 1; its rows are identified by their values."""
    from pyDOE3.doe_optimal import optimal_design

    numbers = {row.tobytes(): number for number, row in enumerate(rows)}

    def choose() -> list[int]:
        design, _ = optimal_design(rows, SIZE, 1, criterion=criterion, method=method)
        return [numbers[np.ascontiguousarray(row).tobytes()] for row in design]

    return choose


NOTE = "always adds an intercept"
TASKS = (
    Task(
        "A, D",
        "greedy (its default)",
        lambda rows: optimal(rows, "D", "sequential"),
        NOTE,
    ),
    Task("A, D", "DETMAX", lambda rows: optimal(rows, "D", "detmax"), NOTE),
    Task("A, E", "DETMAX", lambda rows: optimal(rows, "E", "detmax"), NOTE),
)
