"""Independent draws, ensembles of walkers and importance weights: what they are worth."""

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from arviz_stats import base

from kernel.delta_probe import problem
from oed import posterior
from oed.posterior import LogDensity, importance
from oed.posterior.chains import N_ENSEMBLES, Ensembles, ensemble_sizes
from oed.posterior.importance import (
    StudentProposal,
    draw_weighted,
    fit_pareto,
    resample,
    smoothed_weights,
)
from oed.result import PosteriorSection

Density = Callable[[np.ndarray], np.ndarray]


def normal(x: np.ndarray) -> np.ndarray:
    """Off the proposals' centre, and narrower than they are."""
    return -0.5 * np.sum(((x - 0.4) / 0.8) ** 2, axis=1)


def banana(x: np.ndarray) -> np.ndarray:
    """A ridge along x2 = 3 x1^2, bent far out of the normal about its top."""
    bent = x[:, 1] - 3.0 * (x[:, 0] ** 2 - 1.0)
    rest = np.sum(x[:, 2:] ** 2, axis=1)
    return -0.5 * (x[:, 0] ** 2 + bent**2 / 0.01 + rest)


def funnel(x: np.ndarray) -> np.ndarray:
    """Neal's funnel (2003): x1 is the log scale of all others."""
    size = 3.0 * x[:, 0]
    others = np.sum(x[:, 1:] ** 2, axis=1)
    return -0.5 * (x[:, 0] ** 2 + others * np.exp(-size) + (x.shape[1] - 1) * size)


class Target:
    """A density of four coordinates that are the parameters."""

    dimensions, interrupted = 4, False

    def __init__(self, density: Density) -> None:
        self._density = density

    def draw_lost(self, rng: np.random.Generator, count: int) -> None:
        """No direction is lost."""

    def place(self, points: np.ndarray, w: None) -> tuple[np.ndarray, np.ndarray]:
        return points, points

    def __call__(self, points: np.ndarray, w: None) -> np.ndarray:
        return self._density(points)


def weighted(density, seed, ess):
    """Draws or None, their worth, and k."""
    target = cast(LogDensity, Target(density))
    proposal = StudentProposal(np.zeros(4), np.eye(4))
    rng = np.random.default_rng(seed)
    proposals, k, chosen = draw_weighted(target, proposal, rng, ess, np.inf)
    if chosen is None:
        return None, 0.0, k
    worth = importance.worth(proposals.theta, chosen)
    return proposals.points[chosen], float(worth.min()), k


def test_draws_are_worth_what_they_say():
    """Means of 200 samples scatter by the variance over the effective sample size."""
    means, sizes, squares = [], [], []
    for seed in range(200):
        draws, worth, k = weighted(normal, seed, 150.0)
        assert worth >= 150.0
        assert k < 0.7
        means.append(draws.mean(axis=0) - 0.4)
        squares.append(np.mean((draws - 0.4) ** 2, axis=0))
        sizes.append(worth)
    expected = 0.8**2 / np.mean(sizes)
    assert np.mean(np.square(means)) < 1.2 * expected
    assert np.mean(means, axis=0) == pytest.approx(0.0, abs=0.02)
    assert np.mean(squares, axis=0) == pytest.approx(0.64, rel=0.03)


@pytest.mark.parametrize("density", [banana, funnel])
def test_weights_with_a_heavy_tail_are_refused(density):
    draws, _, k = weighted(density, 1, 1000.0)
    assert draws is None
    assert k > PosteriorSection.largest_pareto_k(1_000_000)


def test_a_density_whose_weights_fail_is_sampled_by_emcee(monkeypatch):
    m, series, y, estimate = problem(distances=True)
    target = LogDensity(m, series, y, estimate)
    root, centre = np.linalg.inv(target.root), target.centre

    def bent(_: LogDensity, points: np.ndarray, w: np.ndarray | None) -> np.ndarray:
        return banana((points - centre) @ root.T)

    monkeypatch.setattr(LogDensity, "_log_density", bent)
    rng = np.random.default_rng(3)
    drawn = posterior.sample(m, series, y, estimate, rng, max_steps=60)
    assert drawn.sampler == "emcee"
    assert drawn.pareto_k > 0.7
    assert drawn.proposals > 0
    assert 0.0 < drawn.acceptance < 1.0


def test_each_proposal_is_drawn_as_its_weight_says():
    """To the whole number below or above, in a random order."""
    rng = np.random.default_rng(4)
    weights = rng.dirichlet(np.ones(50))
    chosen = resample(weights, 400, rng)
    assert np.abs(np.bincount(chosen, minlength=50) - 400 * weights).max() < 1.0
    assert (np.diff(chosen) < 0).any()


@pytest.mark.parametrize("count", [200, 1000, 5000])
@pytest.mark.parametrize("freedom", [2.0, 5.0, 30.0])
def test_weights_are_smoothed_as_by_arviz(count, freedom):
    rng = np.random.default_rng([count, int(freedom)])
    log_weights = rng.standard_t(freedom, count)
    weights, k = smoothed_weights(log_weights)
    wanted, wanted_k = base.array_stats.psislw(-log_weights)
    assert weights == pytest.approx(np.exp(wanted), rel=1e-9)
    assert k == pytest.approx(float(wanted_k), rel=1e-9)


@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.7])
def test_the_shape_of_a_pareto_tail_is_found(shape):
    """Quantiles of the distribution itself: F^-1(p) = scale ((1 - p)^-k - 1) / k."""
    levels = np.arange(0.5, 5000) / 5000
    excess = 2.0 * ((1.0 - levels) ** -shape - 1.0) / shape
    found, scale = fit_pareto(excess)
    assert found == pytest.approx(shape, abs=0.01)
    assert scale == pytest.approx(2.0, rel=0.02)


def test_equal_weights_have_no_tail_and_few_have_no_shape():
    assert smoothed_weights(np.zeros(1000))[1] == 0.0
    weights, k = smoothed_weights(np.log([1.0, 3.0]))
    assert k == math.inf
    assert weights == pytest.approx([0.25, 0.75])


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
