"""FIGAROH: the optimisers behind its optimal calibration, given information matrices
instead of a robot.
"""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choice, Task

REQUIRES = ("figaroh==1.0.2", "picos==2.6.2", "cvxopt==1.3.3")


def socp(rows: np.ndarray) -> Choice:
    """Relaxed weights by picos and CVXOPT; the 30 largest (its own rule takes all above
    1e-5).
    """
    from figaroh.optimal.base_optimal_calibration import SOCPOptimizer

    pool = dict(enumerate(rows[:, :, None] * rows[:, None, :]))
    return lambda: list(SOCPOptimizer(pool, {"NbSample": len(rows)}).solve()[1])[:SIZE]


def detmax(rows: np.ndarray) -> Choice:
    """Its exchange from one random start."""
    from figaroh.optimal.base_optimal_calibration import Detmax

    exchange = Detmax(dict(enumerate(rows[:, :, None] * rows[:, None, :])), SIZE)

    def choose() -> list[int]:
        held: list[int] = []

        def keep(
            chosen: list[int],
        ) -> float:  # the class keeps its set in a local variable of `main_algo`
            held[:] = chosen
            return evaluate(chosen)

        evaluate = exchange.get_critD
        exchange.get_critD = keep
        exchange.main_algo()
        return held

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
