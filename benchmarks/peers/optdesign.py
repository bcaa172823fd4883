"""optdesign: exchange of one row at a time from a given order of the rows."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("optdesign==1.0.0",)


def exchange(rows: np.ndarray, starts: int) -> Choose:
    """Best of `starts` random orders."""
    from optdesign import opt_dmetric, setup_random

    def choose() -> np.ndarray:
        rng = np.random.default_rng(1)
        best_score, best = -np.inf, None
        for _ in range(starts):
            order = np.asarray(setup_random(rows, rng))
            chosen = order[opt_dmetric(rows[order], SIZE, maxiter=1000)[:SIZE]]
            score = float(np.linalg.slogdet(rows[chosen].T @ rows[chosen])[1])
            if score > best_score:
                best_score, best = score, chosen
        return best

    return choose


TASKS = (
    Task("A, D", "exchange, 1 start", lambda rows: exchange(rows, 1), "D only"),
    Task("A, D", "exchange, 100 starts", lambda rows: exchange(rows, 100), "D only"),
)
