"""Bases and roots that depend on the matrix alone, not on the library."""

import numpy as np
import pytest
from scipy import linalg, stats

from oed.base import Array
from oed.linear_algebra import (
    canonical_rows,
    covariance_root,
    eigenvectors,
    precision_root,
    right_singular,
    symmetric_root,
)

#: singular values with a pair, and two that are nothing
VALUES = np.array([5.0, 3.0, 3.0, 1.0, 0.0, 0.0])


def turned(rng: np.random.Generator, rows: Array) -> Array:
    """The same spaces by other vectors: signs, and turns of equal values."""
    signs = np.where(rng.random(len(rows)) < 0.5, -1.0, 1.0)
    other = signs[:, None] * rows
    for first, stop in ((1, 3), (4, 6)):
        turn = stats.ortho_group.rvs(2, random_state=rng)
        other[first:stop] = turn @ other[first:stop]
    return other


def test_the_basis_of_a_space_is_always_the_same(rng):
    rows = stats.ortho_group.rvs(6, random_state=rng)
    chosen = canonical_rows(rows, VALUES)
    assert chosen @ chosen.T == pytest.approx(np.eye(6), abs=1e-12)
    for first, stop in ((0, 1), (1, 3), (3, 4), (4, 6)):
        of_space = rows[first:stop].T @ rows[first:stop]
        mine = chosen[first:stop].T @ chosen[first:stop]
        assert mine == pytest.approx(of_space, abs=1e-12)
    for _ in range(20):
        other = canonical_rows(turned(rng, rows), VALUES)
        assert other == pytest.approx(chosen, abs=1e-12)


def test_singular_vectors_and_eigenvectors(rng):
    rows = stats.ortho_group.rvs(6, random_state=rng)
    left = stats.ortho_group.rvs(9, random_state=rng)[:, :6]
    matrix = left @ np.diag(VALUES) @ rows
    values, vectors = right_singular(matrix)
    assert values == pytest.approx(VALUES, abs=1e-12)
    assert (values[4:] == 0.0).all()
    product = matrix.T @ matrix
    assert (vectors.T * values**2) @ vectors == pytest.approx(product, abs=1e-12)
    # the same matrix with other rows has the same vectors
    again = right_singular(stats.ortho_group.rvs(9, random_state=rng) @ matrix)[1]
    assert again == pytest.approx(vectors, abs=1e-9)
    squared, columns = eigenvectors(product)
    assert product @ columns == pytest.approx(columns * squared, abs=1e-11)
    assert right_singular(matrix[:3])[1].shape == (6, 6)


def test_roots_of_covariances(rng):
    """Also of singular ones in mixed units, and of parameters that are held."""
    slopes = rng.standard_normal((6, 3))
    scale = np.array([1e-3, 1.0, 1e-6, 0.0, 2.0, 1e-4])
    covariance = scale[:, None] * (slopes @ slopes.T) * scale
    root = covariance_root(covariance)
    assert root @ root.T == pytest.approx(covariance, rel=1e-9, abs=1e-25)
    assert (root[3] == 0.0).all()
    correlation = np.corrcoef(rng.standard_normal((5, 40)))
    assert symmetric_root(correlation) == pytest.approx(linalg.sqrtm(correlation))
    stacked = covariance_root(np.stack([covariance, 4.0 * covariance]))
    assert stacked[1] == pytest.approx(2.0 * stacked[0])


def test_a_root_does_not_follow_rounding(rng):
    """Equal eigenvalues turn their vectors at a breath; draws must not turn along."""
    turn = stats.ortho_group.rvs(5, random_state=rng)
    covariance = (turn * np.array([1.0, 1.0, 1.0, 0.5, 0.5])) @ turn.T
    breath = 1e-13 * rng.standard_normal((5, 5))
    disturbed = covariance + breath + breath.T
    change = covariance_root(disturbed) - covariance_root(covariance)
    assert np.abs(change).max() < 1e-11


def test_a_root_of_a_precision_has_what_is_determined_far_better():
    """1 + s^2 u u^T: variance 1 / (1 + s^2) along u, 1 across; its inverse loses the first."""
    u = np.array([3.0, -2.0, 5.0, 1.0, 4.0]) / np.sqrt(55.0)
    strength = 1e6
    precision = np.eye(5) + strength**2 * np.outer(u, u)
    root = precision_root(precision)
    assert np.tril(root, -1) == pytest.approx(np.zeros((5, 5)))
    assert np.linalg.norm(root.T @ u) == pytest.approx(1.0 / strength, rel=1e-3)
    across = linalg.null_space(u[None])
    assert across.T @ root @ root.T @ across == pytest.approx(np.eye(4), abs=1e-3)
    stacked = precision_root(np.stack([precision, 4.0 * np.eye(5)]))
    assert stacked[0] == pytest.approx(root)
    assert stacked[1] == pytest.approx(0.5 * np.eye(5))
