"""The noise process: linear-time whitening against dense matrices, and its draws."""

import dataclasses

import numpy as np
import pytest
from shipped_models import laser_ball_bar, prs_spindle

from kernel import bar_circles
from oed.instrument import mount
from oed.measurement import Measurement, reading_structure
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePosterior, NoisePrior, ResidualModel

GIMBAL = {"at_x": 0.0, "at_y": -0.7, "at_z": 0.2}


@pytest.fixture(scope="module")
def circles() -> ReadingStructure:
    """Three circles of 12 readings by a ball bar, whose cup is seated at each."""
    return bar_circles.circles(12)


@pytest.fixture(scope="module")
def laser() -> ReadingStructure:
    """Two runs by a laser ball bar, whose channels have common sources."""
    m = Measurement(
        prs_spindle.machine, [mount(laser_ball_bar.instrument, "laser", **GIMBAL)]
    )
    rng = np.random.default_rng(4)
    command = rng.uniform([0.1, -0.3, -0.3], [0.3, 0.3, 0.3], (10, 3))
    series = m.series("laser", command, run=["a"] * 4 + ["b"] * 6)
    return reading_structure(m, [series], m.nominal)


def covariance(structure: ReadingStructure, laws: Laws, k: int) -> np.ndarray:
    """The covariance of the module's docstring, reading by reading."""
    n = len(structure)
    result = np.zeros((n, n))
    sizes = [laws.level[k], 1.0, laws.seat[k]]
    for i in range(n):
        for j in range(n):
            a, b = structure.chain[i], structure.chain[j]
            value = 0.0
            if a == b:
                lag = abs(structure.position[i] - structure.position[j])
                value += laws.correlated[k] * np.exp(-lag / laws.reach[k])
            if i == j:
                value += 1.0 - laws.correlated[k]
            if structure.run[a] == structure.run[b]:
                for c, kind in enumerate(structure.kinds):
                    product = structure.columns[i, c] * structure.columns[j, c]
                    value += sizes[kind] ** 2 * product
            if structure.course.size:
                course = structure.course[i] @ structure.course[j]
                value += laws.course[k] ** 2 * course
            scales = laws.scale[k, structure.group]
            result[i, j] = value * scales[i] * scales[j]
    return result


@pytest.mark.parametrize("name", ["circles", "laser"])
def test_whitening_is_that_of_dense_matrices(name, request):
    structure = request.getfixturevalue(name)
    rng = np.random.default_rng(0)
    prior = NoisePrior.of(structure)
    laws = prior.laws(rng.standard_normal((3, prior.dimensions)))
    whitening = laws.whitening(structure)
    y = rng.standard_normal((len(structure), 4))
    gram = whitening.gram(y)
    for k in range(3):
        dense = covariance(structure, laws, k)
        exact = y.T @ np.linalg.solve(dense, y)
        log_determinant = np.linalg.slogdet(dense)[1]
        assert gram[k] == pytest.approx(exact, rel=1e-11, abs=1e-9)
        factor = laws.take([k]).factor(structure)
        white = factor.whiten(y)
        assert white.T @ white == pytest.approx(exact, rel=1e-11, abs=1e-9)
        assert factor.log_det == pytest.approx(log_determinant, abs=1e-9)
        assert whitening.log_determinant[k] == pytest.approx(log_determinant, abs=1e-9)


def test_draws_have_the_covariance(circles):
    laws = Laws(*(np.array(v) for v in ([[1.5]], [0.6], [5.0], [0.7], [0.4])))
    many = laws.take([0] * 20_000).whitening(circles)
    errors = many.draw(np.random.default_rng(1))
    dense = covariance(circles, laws, 0)
    standard_error = dense[0, 0] / np.sqrt(20_000)
    assert np.abs(errors.T @ errors / 20_000 - dense).max() < 6.0 * standard_error * 1.5


def test_standardised_laser_readings_have_unit_noise(laser):
    assert laser.decouple is not None
    values = np.random.default_rng(2).standard_normal((5, len(laser)))
    assert pytest.approx(values) == laser.standardise(laser.restore(values).T).T
    assert Laws.stated(laser).scale.shape == (1, len(laser.names))


def median(posterior: NoisePosterior, values: np.ndarray) -> float:
    """Weighted median of a quantity of the laws."""
    order = np.argsort(values)
    share = np.cumsum(posterior.weights[order])
    return float(values[order][np.searchsorted(share, 0.5)])


def test_runs_that_shift_are_recognised(circles):
    """A level of two sigma at each run moves the posterior of the level, not the scale."""
    rng = np.random.default_rng(3)
    structure = dataclasses.replace(
        circles, columns=circles.columns[:, :1], kinds=circles.kinds[:1]
    )
    prior = NoisePrior.of(structure)
    run = structure.run[structure.chain]
    medians = []
    for size in (0.0, 3.0):
        levels = size * np.array([1.0, -1.2, 0.4])
        residual = rng.standard_normal(36) + levels[run]
        slopes = rng.standard_normal((36, 2))
        model = ResidualModel(structure, residual, slopes, np.zeros(2))
        posterior = model.integrate(prior)
        laws = prior.laws(posterior.draws)
        medians.append(median(posterior, laws.level))
        assert 0.6 < median(posterior, laws.scale[:, 0]) < 1.6
    assert medians[0] < 0.8
    assert medians[1] > 1.5
