"""FIGAROH: the optimisers of its calibration, on information matrices, not a robot."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("figaroh==1.0.2", "picos==2.6.2", "cvxopt==1.3.3")


def socp(rows: np.ndarray) -> Choose:
    """The 30 largest relaxed weights by picos and CVXOPT.

    The package itself takes every weight above 1e-5.
    """
    from figaroh.optimal.base_optimal_calibration import SOCPOptimizer

    pool = dict(enumerate(rows[:, :, None] * rows[:, None, :]))
    return lambda: list(SOCPOptimizer(pool, {"NbSample": len(rows)}).solve()[1])[:SIZE]


def detmax(rows: np.ndarray) -> Choose:
    """Its exchange from one random start."""
    from figaroh.optimal.base_optimal_calibration import Detmax

    exchange = Detmax(dict(enumerate(rows[:, :, None] * rows[:, None, :])), SIZE)

    evaluate = exchange.get_critD
    current: list[int] = []

    # the class keeps its set in a local variable of `main_algo`: record it here
    def evaluate_and_record(chosen: list[int]) -> float:
        current[:] = chosen
        return evaluate(chosen)

    def choose() -> list[int]:
        exchange.get_critD = evaluate_and_record
        exchange.main_algo()
        return current

    return choose


TASKS = (
    Task(
        "A, D",
        "SOCP, 30 largest weights",
        socp,
        "chooses how many itself; no exchange after the weights",
    ),
    Task("A, D", "DETMAX", detmax),
)
