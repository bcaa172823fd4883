"""Densities of single errors and noise laws, and residuals far off."""

import itertools

import numpy as np
import pytest
from scipy import integrate, stats

from oed.noise import Laws, NoiseStatement, ReadingStructure
from oed.noise_law import NoisePrior, marginal, outliers, robust_residuals
from oed.noise_law.marginal import (
    STUDENT_DOF,
    KernelMixture,
    SplitStudent,
    kernels_at,
    split_student,
)
from oed.noise_law.outliers import MIN_READINGS


@pytest.mark.parametrize("shape", outliers.CANDIDATE_DENSITIES, ids=str)
def test_a_shape_is_a_density_with_its_score(shape):
    def density(e: float) -> float:
        return float(np.exp(shape.log_density(np.array(e))))

    whole, _ = integrate.quad(density, -np.inf, np.inf, limit=400)
    assert whole == pytest.approx(1.0, abs=1e-6)
    e, step = np.array([-40.0, -7.0, -2.5, -0.3, 0.2, 1.0, 3.0, 4.0, 12.0]), 1e-5
    slope = (shape.log_density(e + step) - shape.log_density(e - step)) / (2.0 * step)
    assert shape.weight(e) * e == pytest.approx(-slope, rel=1e-4, abs=1e-7)


def test_a_student_is_scipy_s_and_its_information_is_known():
    e = np.linspace(-20.0, 20.0, 41)
    for n in outliers.STUDENT_DOF:
        assert outliers.StudentT(n).log_density(e) == pytest.approx(
            stats.t(n).logpdf(e)
        )
        assert outliers.fisher_information(outliers.StudentT(n)) == pytest.approx(
            (n + 1.0) / (n + 3.0), abs=1e-4
        )


def test_few_strays_cost_next_to_no_information():
    """Less than if the noise were as large as its variance says."""
    shares, scales = outliers.OUTLIER_SHARES, outliers.OUTLIER_SCALES
    for share, wild in itertools.product(shares, scales):
        information = outliers.fisher_information(
            outliers.ContaminatedNormal(share, wild)
        )
        assert 1.0 / (1.0 - share + share * wild**2) < information < 1.0
        assert information > 1.0 - 4.0 * share


@pytest.mark.parametrize("shape", [
    outliers.StudentT(3.0), outliers.StudentT(6.0),
    outliers.ContaminatedNormal(0.02, 10.0),
], ids=str)  # fmt: skip
def test_a_pseudo_error_tells_of_a_small_change_what_the_error_does(shape):
    """Log likelihood ratios of a shift by a tenth, one reading in ten thousand."""
    rng = np.random.default_rng(5)
    if isinstance(shape, outliers.StudentT):
        e = rng.standard_t(shape.dof, 10_000)
    else:
        e = rng.standard_normal(10_000) * np.where(
            rng.random(10_000) < shape.outlier_share, shape.outlier_scale, 1.0
        )
    information = outliers.fisher_information(shape)
    normal = shape.weight(e) * e / information
    for shift in (-0.06, 0.03, 0.06):
        exact = (shape.log_density(e - shift) - shape.log_density(e)).sum()
        pseudo = 0.5 * information * (normal**2 - (normal - shift) ** 2).sum()
        assert pseudo == pytest.approx(exact, abs=1.5)


def test_the_mode_of_a_law_does_not_hang_on_rounding():
    """A cost of some hundreds, whose search alone ends a few hundredths away."""
    turned, _ = np.linalg.qr(np.random.default_rng(2).standard_normal((4, 4)))
    curvature = turned @ np.diag([0.7, 1.0, 4.0, 30.0]) @ turned.T
    wanted = np.array([0.3, -1.2, 0.8, 0.1])

    def cost(u: np.ndarray) -> np.ndarray:
        offset = u - wanted
        bent = np.sqrt(1.0 + np.einsum("li,ij,lj->l", offset, curvature, offset))
        return 900.0 + bent + 0.02 * offset[:, 0] ** 4

    starts = np.zeros((2, 4))
    starts[1, 0] = 2.0
    mode = marginal.polish(cost, marginal.find_mode(cost, starts, 4.5), 4.5)
    np.testing.assert_allclose(mode, wanted, atol=1e-3)
    root = marginal._signed(marginal.root_about(cost, mode))
    largest = np.argmax(np.abs(root), axis=0)
    assert (root[largest, range(4)] > 0.0).all()


def test_a_stated_law_is_known_to_a_third_or_a_half():
    """A deviation on is a reach of 1.35, sizes of 1.5, and a share of odds twice those stated."""
    names = ("scale", NoisePrior.CORRELATED, NoisePrior.REACH)
    names = (*names, NoisePrior.STATED_RUN, NoisePrior.STATED_SEATING)
    prior = NoisePrior(names, 1, NoiseStatement(correlated=0.4, reach=6.0))
    middle, ahead = (prior.laws(np.full((1, 5), u)) for u in (0.0, 1.0))
    assert middle.reach == pytest.approx([6.0])
    assert ahead.reach == pytest.approx([6.0 * 1.35], rel=0.01)
    for size in (ahead.stated_level, ahead.stated_seat):
        assert size == pytest.approx([1.5], rel=0.01)
    assert ahead.correlated == pytest.approx([4.0 / 7.0], rel=0.01)


MODE, ROOT = np.array([1.0, -2.0]), np.array([[2.0, 0.0], [0.5, 0.3]])


def test_a_split_student_of_equal_widths_is_scipys(rng):
    split = SplitStudent(MODE, ROOT, np.full(2, 1.5), np.full(2, 1.5))
    points = MODE + rng.standard_normal((20, 2))
    exact = stats.multivariate_t(MODE, 2.25 * ROOT @ ROOT.T, df=STUDENT_DOF)
    assert split.log_density(points) == pytest.approx(exact.logpdf(points))


def test_a_split_student_has_the_mass_of_its_widths_on_either_side():
    split = SplitStudent(np.zeros(1), np.eye(1), np.array([1.0]), np.array([3.0]))

    def density(u: float) -> float:
        return float(np.exp(split.log_density(np.array([[u]]))[0]))

    below = integrate.quad(density, -np.inf, 0.0)[0]
    above = integrate.quad(density, 0.0, np.inf)[0]
    assert (below, above) == pytest.approx((0.25, 0.75))
    points = split.points(4095)[:, 0]
    assert np.mean(points < 0.0) == pytest.approx(0.25, abs=2e-3)
    ahead = stats.t(STUDENT_DOF).ppf(0.75) * 3.0
    assert np.median(points[points > 0.0]) == pytest.approx(ahead, rel=1e-2)


def test_widths_are_those_of_the_cost():
    """Of a normal density that is twice as wide ahead of the mode as behind it."""

    def cost(u: np.ndarray) -> np.ndarray:
        return 0.5 * np.where(u[:, 0] > 0.0, 0.5 * u[:, 0], u[:, 0]) ** 2

    split = split_student(cost, np.zeros(1), np.eye(1))
    assert split.behind == pytest.approx([1.0])
    assert split.ahead == pytest.approx([2.0])


def test_kernels_are_a_mixture_of_scipys(rng):
    centres, weights = np.array([[0.0, 0.0], [3.0, 1.0]]), np.array([0.2, 0.8])
    mixture = KernelMixture(centres, weights, ROOT)
    points = rng.standard_normal((15, 2))
    exact = sum(
        w * stats.multivariate_t(c, ROOT @ ROOT.T, df=STUDENT_DOF).pdf(points)
        for c, w in zip(centres, weights, strict=True)
    )
    assert mixture.log_density(points) == pytest.approx(np.log(exact))
    drawn = mixture.points(8191)
    assert drawn.mean(axis=0) == pytest.approx(weights @ centres, abs=0.05)


def test_kernels_of_equal_weights_follow_silvermans_rule(rng):
    draws = rng.standard_normal((200, 2)) @ ROOT.T
    mixture = kernels_at(draws, np.full(200, -7.0))
    assert mixture.weights == pytest.approx(np.full(200, 1.0 / 200.0))
    width = 200.0 ** (-1.0 / 6.0)  # (4 / (d + 2) n)^(1 / (d + 4)) for d = 2
    expected = width**2 * np.cov(draws.T, bias=True)
    assert mixture.root @ mixture.root.T == pytest.approx(expected)


def test_weights_count_by_their_square_root():
    mixture = kernels_at(np.array([[0.0], [1.0]]), np.log([0.2, 0.8]))
    assert mixture.weights == pytest.approx([1.0 / 3.0, 2.0 / 3.0])


def test_few_laws_of_ten_coordinates_are_wasted():
    """Of a normal density, whose integral is 1 whatever the number of coordinates."""

    def cost(u: np.ndarray) -> np.ndarray:
        return 0.5 * (u**2).sum(axis=1)

    split = split_student(cost, np.zeros(10), np.eye(10))
    points = split.points(320)
    weights = np.exp(-cost(points) - split.log_density(points)) / (2.0 * np.pi) ** 5
    assert weights.mean() == pytest.approx(1.0, abs=0.1)
    assert weights.sum() ** 2 / (weights @ weights) > 100.0


def single_run(count: int) -> ReadingStructure:
    """Readings of one channel in one run, which share nothing."""
    nothing = np.zeros(count, dtype=np.intp)
    return ReadingStructure(
        names=("cup.length",), group=nothing, chain=nothing, run=nothing[:1],
        position=np.arange(float(count)), unit=np.ones(count), decouple=None,
        columns=np.zeros((count, 0)), kinds=nothing[:0],
    )  # fmt: skip


def test_a_reading_far_off_is_replaced_and_the_others_are_not():
    """The machine may do anything that is linear along the run."""
    structure = single_run(60)
    line = np.column_stack([np.ones(60), np.linspace(-1.0, 1.0, 60)])
    rng = np.random.default_rng(7)
    residual = line @ np.array([20.0, -35.0]) + rng.standard_normal(60)
    mistaken = residual.copy()
    mistaken[17] += 60.0
    clean = robust_residuals(structure, Laws.stated(structure), mistaken, 100.0 * line)
    assert abs(clean[17] - residual[17]) < 4.0
    others = np.arange(60) != 17
    assert np.abs(clean - residual)[others].max() < 1.0
    assert mistaken[17] == residual[17] + 60.0


@pytest.mark.parametrize(("seed", "size"), [(1, 100.0), (3, 1e9)])
def test_what_the_machine_may_do_is_no_outlier(seed, size):
    """A column of any size determines it: what is left of 1 - 1 is rounding."""
    structure = single_run(30)
    residual = np.random.default_rng(seed).standard_normal(30)
    residual[4] += 60.0
    slopes = size * np.eye(30)[:, [4]]
    clean = robust_residuals(structure, Laws.stated(structure), residual, slopes)
    assert np.abs(clean - residual).max() < 1.0


def test_few_readings_stay_as_they_are():
    structure = single_run(MIN_READINGS - 1)
    residual = np.zeros(MIN_READINGS - 1)
    residual[0] = 1e3
    clean = robust_residuals(
        structure, Laws.stated(structure), residual, np.zeros((MIN_READINGS - 1, 0))
    )
    assert clean is not residual
    assert (clean == residual).all()
