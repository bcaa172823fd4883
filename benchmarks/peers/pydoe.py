"""pyDOE: greedy, then exchange passes over the rows of a Jacobian."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("pydoe==1.6.0",)


def jacobian(rows: np.ndarray, criterion: str) -> Choose:
    """Its `jacobian_optimal_design` with its defaults."""
    from pydoe import jacobian_optimal_design

    return lambda: jacobian_optimal_design(rows, SIZE, criterion=criterion)[0]


NOTE = "may repeat rows"
TASKS = (
    Task("A, D", "greedy, exchange", lambda rows: jacobian(rows, "D"), NOTE),
    Task("A, E", "greedy, exchange", lambda rows: jacobian(rows, "E"), NOTE),
)
