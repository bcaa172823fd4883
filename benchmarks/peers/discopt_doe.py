"""discopt-doe: points one after the other, each by several starts of L-BFGS-B."""

from __future__ import annotations

import numpy as np

from peers import COLUMNS, FACTORS, SIZE, Choice, Task

REQUIRES = ("discopt-doe==0.3.0",)


def greedy(criterion: str = "determinant") -> Choice:
    """Its `linear_batch_design` with its defaults."""
    from discopt.doe.linear_design import linear_batch_design

    names = [f"x{k}" for k in range(FACTORS)]

    def choose() -> np.ndarray:
        found = linear_batch_design(
            "linear",
            SIZE,
            parameter_names=[f"b{k}" for k in range(COLUMNS)],
            input_names=names,
            design_bounds=dict.fromkeys(names, (-1.0, 1.0)),
            criterion=criterion,
        )
        return np.array([[point[name] for name in names] for point in found.designs])

    return choose


TASKS = (
    Task(
        "B, D",
        "greedy, L-BFGS-B",
        greedy,
        "one point after the other, no exchange; no list of rows",
    ),
)
