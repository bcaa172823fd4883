"""Ensembles of walkers on a normal density whose moments are known."""

from typing import Any

import numpy as np
import pytest

from oed.posterior.chains import N_ENSEMBLES, Ensembles, ensemble_sizes

MEAN, ROOT = np.array([3.0, -1.0]), np.array([[2.0, 0.0], [1.0, 0.5]])


class Normal:
    """A normal density with the proposal of its own Laplace approximation."""

    dimensions, interrupted = 2, False

    def __call__(self, points: np.ndarray) -> np.ndarray:
        white = np.linalg.solve(ROOT, (points - MEAN).T)
        return np.asarray(-0.5 * (white**2).sum(axis=0))

    def starts(self, rng: np.random.Generator, size: int) -> np.ndarray:
        return np.asarray(MEAN + rng.standard_normal((size, 2)) @ ROOT.T)

    def propose(self, points: np.ndarray, random: Any) -> tuple[Any, Any]:
        drawn = MEAN + random.standard_normal(points.shape) @ ROOT.T
        return drawn, self(points) - self(drawn)


def ensembles() -> Ensembles:
    target: Any = Normal()
    rng = np.random.default_rng(4)
    return Ensembles(target, [8, 9, 8], rng, target.starts)


def test_walkers_are_shared_out():
    assert ensemble_sizes(None, 3) == [16] * N_ENSEMBLES
    assert ensemble_sizes(None, 20) == [44] * N_ENSEMBLES
    sizes = ensemble_sizes(50, 4)
    assert sum(sizes) == 50
    assert len(sizes) == N_ENSEMBLES
    assert min(sizes) >= 8
    # fewer than twice the dimensions would not span them
    assert ensemble_sizes(3, 10) == [22]


def test_points_have_the_moments_of_the_density():
    members = ensembles()
    assert (members.iteration, members.walkers) == (0, 25)
    members.run_to(400)
    assert members.iteration == 400
    points = members.chains(burn_in=50)
    assert points.shape == (25, 350, 2)
    flat = points.reshape(-1, 2)
    sd = np.sqrt(np.diag(ROOT @ ROOT.T))
    assert (flat.mean(axis=0) - MEAN) / sd == pytest.approx(0.0, abs=0.1)
    assert np.cov(flat.T) == pytest.approx(ROOT @ ROOT.T, rel=0.15)
    assert 0.3 < members.acceptance <= 1.0
    assert 1.0 <= members.autocorrelation() < 20.0


def test_values_are_ordered_by_ensemble():
    """Each with as many walkers as the smallest, step after step."""
    members = ensembles()
    number = np.arange(25.0)[:, None, None]
    values = np.tile(number, (1, 3, 1)) + 0.1 * np.arange(3)[None, :, None]
    ordered = members.group_by_ensemble(values)
    assert ordered.shape == (3, 24, 1)
    for first, of_ensemble in zip((0, 8, 17), ordered[:, :, 0], strict=True):
        expected = [first + w + 0.1 * step for step in range(3) for w in range(8)]
        assert of_ensemble == pytest.approx(expected)
