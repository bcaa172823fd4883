"""doetools: Fedorov's exchange on a whitened model matrix."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("doetools==0.1.8",)


def fedorov(rows: np.ndarray, size: int = SIZE) -> Choose:
    """Its `optimize_d_optimal` with its 50 random starts."""
    from doetools.design.d_opt.optimizer import optimize_d_optimal

    return lambda: optimize_d_optimal(
        rows, n_min=size, n_max=size, random_state=1
    ).best_indices[size]


TASKS = (Task("A, D", "Fedorov exchange, 50 starts", fedorov, "D only"),)
