"""Ranks of candidates and values of a shortlist against sums computed one by one."""

import numpy as np
import pytest

from oed.design.forms.eigenvalues import (
    SHORTLIST_SIZE,
    evaluate_shortlist,
    rank_by_spread,
    rank_by_variance,
)


def test_ranks_are_changes_of_trace_and_largest_eigenvalue(
    rng: np.random.Generator,
) -> None:
    root, blocks = rng.standard_normal((9, 4)), rng.standard_normal((6, 2, 4))
    m = root.T @ root
    values, vectors = np.linalg.eigh(m)
    trace = np.trace(np.linalg.inv(m))
    after = [np.trace(np.linalg.inv(m + x.T @ x)) for x in blocks]
    reduction = trace - np.array(after)
    assert rank_by_variance(values, vectors, blocks) == pytest.approx(reduction)
    # by first order: what a block has along the eigenvector of the largest eigenvalue
    rise = [np.sum((x @ vectors[:, -1]) ** 2) / values[-1] for x in blocks]
    expected = np.log1p(reduction / trace) - 0.3 * np.log1p(rise)
    assert rank_by_spread(values, vectors, blocks, 0.3) == pytest.approx(expected)


def test_a_shortlist_has_the_first_by_each_rank(rng: np.random.Generator) -> None:
    blocks, m = rng.standard_normal((60, 1, 3)), np.eye(3)
    first, second = rng.standard_normal((2, 60))

    def least(eigenvalues: np.ndarray) -> np.ndarray:
        return eigenvalues[:, 0]

    values = evaluate_shortlist(least, m, blocks, first, second)
    places = SHORTLIST_SIZE // 2
    expected = {*np.argsort(-first)[:places], *np.argsort(-second)[:places]}
    assert set(np.flatnonzero(np.isfinite(values))) == expected
    for k in expected:
        exact = np.linalg.eigvalsh(m + blocks[k].T @ blocks[k])[0]
        assert values[k] == pytest.approx(exact)
