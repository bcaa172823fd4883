"""Exchanges of rows against determinants computed for all pairs."""

import numpy as np
import pytest

from oed.design.row_exchange import exchange_rows


@pytest.mark.parametrize("seed", range(4))
def test_no_exchange_of_one_row_raises_the_determinant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, base = rng.standard_normal((15, 3)), 1e-3 * np.eye(3)
    start = rng.choice(15, 5, replace=False)

    def log_det(chosen: np.ndarray) -> float:
        return float(np.linalg.slogdet(rows[chosen].T @ rows[chosen] + base)[1])

    chosen = exchange_rows(rows, start, base)
    assert len(set(chosen.tolist())) == 5
    assert log_det(chosen) > log_det(start)
    for place in range(5):
        for other in set(range(15)) - set(chosen.tolist()):
            changed = chosen.copy()
            changed[place] = other
            assert log_det(changed) <= log_det(chosen) + 1e-8
