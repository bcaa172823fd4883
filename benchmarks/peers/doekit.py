"""doekit: KL exchange for D, Fedorov's for the other criteria, on a model matrix."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("doekit==0.9.1",)


def kl(rows: np.ndarray) -> Choose:
    """Its `kl_exchange` with its defaults."""
    from doekit.generation.search.optimal import kl_exchange

    return lambda: kl_exchange(rows, SIZE, rng=np.random.default_rng(1))


def fedorov(rows: np.ndarray) -> Choose:
    """Its `fedorov_exchange` for the least eigenvalue."""
    from doekit.domain.criteria import get_criterion
    from doekit.generation.search.optimal import fedorov_exchange

    return lambda: fedorov_exchange(
        rows, SIZE, get_criterion("E"), rng=np.random.default_rng(1)
    )


TASKS = (Task("A, D", "KL exchange", kl), Task("A, E", "Fedorov exchange", fedorov))
