"""Effects and processes of the noise: whitening and draws against dense matrices."""

import dataclasses

import numpy as np
import pytest
from shipped_models import laser_ball_bar, prs_spindle

from kernel import bar_circles
from kernel.laws import dense_covariance
from oed.instrument import mount
from oed.measurement import Measurement, reading_structure
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePosterior, NoisePrior, ResidualModel, robust_residuals

EFFECTS = 5


@pytest.fixture(scope="module")
def structure() -> ReadingStructure:
    """Runs of a ball bar, with five columns of effects."""
    bare = bar_circles.circles(12)
    columns = 3.0 * np.random.default_rng(1).standard_normal((len(bare), EFFECTS))
    return dataclasses.replace(bare, effects=columns)


@pytest.fixture(scope="module")
def laws(structure: ReadingStructure) -> Laws:
    prior = NoisePrior.of(structure)
    draws = np.random.default_rng(2).standard_normal((3, prior.dimensions))
    return prior.laws(draws)


def dense(structure: ReadingStructure, laws: Laws, k: int) -> np.ndarray:
    noise = dense_covariance(structure, laws.take([k]))
    return noise + structure.effects @ structure.effects.T


def test_products_and_determinant_are_those_of_dense_matrices(structure, laws):
    y = np.random.default_rng(3).standard_normal((len(structure), 4))
    whitening = laws.whitening(structure)
    determinant_first = laws.whitening(structure).log_determinant
    gram = whitening.gram(y)
    for k in range(len(laws)):
        covariance = dense(structure, laws, k)
        exact = y.T @ np.linalg.solve(covariance, y)
        assert gram[k] == pytest.approx(exact, rel=1e-9, abs=1e-9)
        log_determinant = np.linalg.slogdet(covariance)[1]
        assert whitening.log_determinant[k] == pytest.approx(log_determinant, abs=1e-8)
        assert determinant_first[k] == pytest.approx(log_determinant, abs=1e-8)


def test_readings_of_each_law_of_their_own(structure, laws):
    y = np.random.default_rng(4).standard_normal((len(laws), len(structure), 1))
    gram = laws.whitening(structure).gram(y)
    for k in range(len(laws)):
        exact = y[k, :, 0] @ np.linalg.solve(dense(structure, laws, k), y[k, :, 0])
        assert gram[k, 0, 0] == pytest.approx(exact, rel=1e-9)


def test_noise_under_a_law_whitens_with_the_effects(structure, laws):
    noise = laws.noise(structure)
    unit = structure.unit
    precision = np.linalg.inv(dense(structure, laws, 0) * unit[:, None] * unit)
    white = noise.whiten(np.eye(len(structure)))
    scale = np.abs(precision).max()
    assert white.T @ white == pytest.approx(precision, abs=1e-9 * scale)
    back = noise.whiten_back(white)
    assert back == pytest.approx(precision, abs=1e-9 * scale)
    diagonal = noise.precision_diagonal()
    assert diagonal == pytest.approx(np.diag(precision), rel=1e-7)
    of_dense = np.sqrt(np.diag(dense(structure, laws, 0))) * unit
    assert noise.sigma == pytest.approx(of_dense, rel=1e-9)


def test_what_effects_explain_is_not_far_off(structure, laws):
    residual = 10.0 * structure.effects[:, 0]
    slopes = np.zeros((len(structure), 1))
    law = laws.take([0])
    kept = robust_residuals(structure, law, residual, slopes)
    assert kept == pytest.approx(residual)


@pytest.mark.parametrize("scale", [1e-2, 1e-4, 1e-7])
def test_the_evidence_of_a_law_far_below_the_stated_noise_is_no_garbage(
    structure, scale
):
    """Against a triangle of all columns, which squares no condition number."""
    rng = np.random.default_rng(7)
    law = Laws.stated(structure, scale=scale)
    # more effects than readings: they take all that is not noise
    effects = 50.0 * rng.standard_normal((len(structure), 2 * len(structure)))
    wide = dataclasses.replace(structure, effects=effects)
    slopes = 1e3 * rng.standard_normal((len(structure), 6))
    residual, centre = rng.standard_normal(len(structure)), rng.standard_normal(6)
    solutions = ResidualModel(wide, residual, slopes, centre).solve(law)
    columns = np.column_stack([effects, slopes, residual]) / scale
    prior = np.eye(columns.shape[1])[:-1]
    prior[-6:, -1] = -centre
    triangle = np.linalg.qr(np.vstack([columns, prior]), mode="r")
    log_size = 2.0 * np.log(np.abs(np.diag(triangle)[:-1])).sum()
    log_size += 2.0 * len(structure) * np.log(scale)
    exact = -0.5 * (log_size + triangle[-1, -1] ** 2)
    if scale < 1e-6:  # rounding hides what is left: such a law must not look probable
        assert solutions.log_marginal[0] < exact
        return
    assert solutions.log_marginal[0] == pytest.approx(exact, rel=2e-3)
    _, root = np.split(np.linalg.inv(triangle[:-1, :-1]), [-6])
    spread = np.sqrt(np.diag(root[:, -6:] @ root[:, -6:].T))
    own = np.linalg.norm(solutions.root[0], axis=1)
    assert own == pytest.approx(spread, rel=3e-2)


def test_draws_have_the_covariance(structure, laws):
    count = 4000
    errors = laws.take([0] * count).whitening(structure).draw(np.random.default_rng(5))
    wanted = np.diag(dense(structure, laws, 0))
    ratio = (errors**2).mean(axis=0) / wanted
    # 4000 draws: a standard error of 2.2 %
    assert np.abs(ratio - 1.0).max() < 0.12


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


def test_draws_of_circles_have_the_covariance(circles):
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
