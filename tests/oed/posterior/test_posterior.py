"""The sampler: Laplace, quadrature, rejection, interpolated readings, predictive checks."""

import dataclasses
import functools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import special, stats
from shipped_models import a3_head, ball_bar, height_probe, linear_delta

from kernel import a3_plans
from kernel.delta_probe import problem
from oed import posterior, safe_files
from oed.base import Array
from oed.corrected import MeasurementWithEffects
from oed.estimation import Estimate, identify
from oed.instrument import mount
from oed.measurement import (
    Measurement,
    Series,
    draw_parameters,
    draw_readings,
    reading_structure,
)
from oed.posterior import LogDensity, OutOfBoundsError, log_density, predictive_checks
from oed.posterior.posterior import DISCREPANCIES


@pytest.mark.parametrize(
    ("distances", "sampler"), [(False, "auto"), (True, "auto"), (True, "emcee")]
)
def test_a_nearly_linear_problem_has_the_laplace_posterior(distances, sampler):
    """Means within 4.5 standard errors, spreads too: 1000 effective draws give 3.2 % and 2.2 %."""
    m, series, y, estimate = problem(distances=distances)
    drawn = posterior.sample(
        m, series, y, estimate, np.random.default_rng(1), sampler=sampler, ess=1000
    )
    assert drawn.ess[m.free].min() >= 1000
    assert np.isnan(drawn.ess[~m.free]).all()
    flat, sd = drawn.pooled[:, m.free], estimate.sd[m.free]
    assert (flat.mean(axis=0) - estimate.theta[m.free]) / sd == pytest.approx(
        0.0, abs=4.5 / np.sqrt(1000)
    )
    assert flat.std(axis=0) / sd == pytest.approx(1.0, abs=4.5 / np.sqrt(2000))
    exact = estimate.covariance[np.ix_(m.free, m.free)] / np.outer(sd, sd)
    correlation = np.corrcoef(flat.T) - exact
    assert np.abs(correlation).max() < 4.5 / np.sqrt(1000)
    assert (drawn.pooled[:, ~m.free] == m.nominal[~m.free]).all()
    if sampler == "emcee":
        assert drawn.rhat[m.free].max() < 1.03
        assert 0.1 < drawn.acceptance < 0.95
    else:
        assert drawn.sampler == "importance"
        assert drawn.pareto_k < 0.5
        assert np.isnan(drawn.rhat).all()


def test_the_same_seed_gives_the_same_draws():
    m, series, y, estimate = problem(distances=True)
    first, again, other = (
        posterior.sample(m, series, y, estimate, np.random.default_rng(seed), ess=200)
        for seed in (5, 5, 6)
    )
    assert (first.draws == again.draws).all()
    assert not np.array_equal(first.draws[:, :50], other.draws[:, :50])


def test_an_unknown_noise_scale_has_the_posterior_of_the_quadrature():
    """By importance sampling of the exact marginal likelihood, with dense matrices."""
    m, series, y, estimate = problem(
        distances=False, readings=14, noise=3.0, estimate_noise=True
    )
    drawn = posterior.sample(m, series, y, estimate, np.random.default_rng(2), ess=1000)
    assert drawn.sampler == "importance"
    assert drawn.noise_names[0] == "noise of probe.height"
    h = m.jacobian(series, estimate.theta)
    miss = y - m.readings(series, estimate.theta) + h @ (estimate.theta - m.nominal)
    u = np.random.default_rng(7).standard_normal((40_000, 4))
    scale = np.exp(0.4 * u[:, 0] * (1.0 + (np.maximum(u[:, 0], 0.0) / 4.0) ** 2))
    level = 0.4 * np.exp(1.3 * u[:, 3])
    share = np.sin(0.25 * np.pi * (1.0 + special.erf(u[:, 1] / np.sqrt(2.0)))) ** 2
    reach = 8.0 * np.exp(u[:, 2])
    sigma = m.sigma(series)
    distance = np.abs(np.subtract.outer(np.arange(14), np.arange(14)))
    decay = np.exp(-distance / reach[:, None, None])
    noise = share[:, None, None] * decay + level[:, None, None] ** 2
    noise = noise + (1.0 - share)[:, None, None] * np.eye(14)
    spread = noise * np.outer(sigma, sigma) * scale[:, None, None] ** 2
    spread = spread + (h * m.tolerance**2) @ h.T
    solved = np.linalg.solve(spread, np.tile(miss[:, None], (len(u), 1, 1)))[..., 0]
    log = -0.5 * (np.linalg.slogdet(spread)[1] + solved @ miss)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = weight @ u
    sd = np.sqrt(weight @ (u - mean) ** 2)
    draws = drawn.noise_law.reshape(-1, 4)
    assert (draws.mean(axis=0) - mean) / sd == pytest.approx(0.0, abs=0.2)
    assert draws.std(axis=0) / sd == pytest.approx(1.0, abs=0.15)
    assert draws[:, 0].mean() > 1.0


def test_a_known_noise_is_not_sampled():
    m, series, y, estimate = problem(distances=False)
    drawn = posterior.sample(m, series, y, estimate, np.random.default_rng(2), ess=200)
    assert drawn.noise_names == ()
    assert drawn.noise_law.shape[2] == 0


@pytest.mark.parametrize("follows", [False, True])
def test_draws_of_a_machine_with_lost_directions_still_read_as_observed(
    follows, monkeypatch
):
    """Three turns of the platform's joints stay at their tolerance; every draw fits."""
    m = a3_plans.measurement()
    series = [a3_plans.circles(m, 15)]
    rng = np.random.default_rng(3)
    if follows:
        monkeypatch.setattr(log_density, "MAX_LEFT", 0.0)
    y = draw_readings(m, series, a3_plans.table_3(m), rng)
    estimate = identify(m, series, y)
    drawn = posterior.sample(m, series, y, estimate, rng, ess=300)
    white = estimate.noise.whiten_last(m.readings(series, drawn.pooled[::97]) - y)
    expected = estimate.chi2 + (
        30 - estimate.dof
    )  # chi2 at the top, and one for each direction the readings settle
    assert np.mean(np.sum(white**2, axis=1)) == pytest.approx(expected, rel=0.15)
    assert drawn.pooled.std(axis=0)[m.free] == pytest.approx(
        estimate.sd[m.free], rel=0.15
    )
    local, target = estimate.coordinates, LogDensity(m, series, y, estimate)
    assert (target.bend is None) == follows
    lost = np.linalg.pinv(local.null_basis) @ (drawn.pooled - estimate.theta).T
    assert lost.std(axis=1) == pytest.approx(1.0, abs=0.1)


def test_the_density_along_lost_directions_is_that_of_its_parameters():
    """The fitted shift of z costs no accuracy: the density is that at theta itself."""
    m = a3_plans.measurement()
    series, rng = [a3_plans.circles(m, 15)], np.random.default_rng(3)
    y = draw_readings(m, series, a3_plans.table_3(m), rng)
    estimate = identify(m, series, y)
    target = LogDensity(m, series, y, estimate)
    points, w = target.starts(rng, 20), 2.0 * rng.standard_normal((20, 3))
    theta = target.place(points, w)[1]
    scaled = (theta - m.nominal)[:, m.free] / m.tolerance[m.free]
    prior = np.sum(scaled**2, axis=1) - np.sum(w**2, axis=1)
    misfit = np.sum(((m.readings(series, theta) - y) / m.sigma(series)) ** 2, axis=1)
    assert target(points, w) == pytest.approx(-0.5 * (misfit + prior), abs=1e-6)


def test_what_is_kept_is_bounded_and_progress_is_told():
    m, series, y, estimate = problem(distances=True)
    told: list[float] = []
    few = {"ess": 100, "max_draws": 500, "walkers": 40, "progress": told.append}
    rng = np.random.default_rng(2)
    drawn = posterior.sample(m, series, y, estimate, rng, sampler="emcee", **few)
    assert drawn.walkers == 40
    count = drawn.draws.shape[0] * drawn.draws.shape[1]
    assert count <= 500 + 40
    assert drawn.pooled.shape == (count, len(m.names))
    assert drawn.names == m.names
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_the_file_holds_the_draws(tmp_path):
    m, series, y, estimate = problem(distances=False)
    drawn = posterior.sample(m, series, y, estimate, np.random.default_rng(2), ess=200)
    path = tmp_path / "posterior.nc"
    posterior.save(drawn, path, {"study": "test"})
    assert {p.name for p in tmp_path.iterdir()} == {
        "posterior.nc",
        safe_files.LIST_NAME,
    }
    tree = xr.open_datatree(path, engine="h5netcdf")
    assert (tree["posterior"]["theta"].to_numpy() == drawn.draws).all()
    assert tree["posterior"]["parameter"].to_numpy().tolist() == list(m.names)
    assert tree.attrs["study"] == "test"
    other = posterior.save(drawn, tmp_path / "other.nc", {"study": "test"})
    assert other.read_bytes() == path.read_bytes()
    assert tree.attrs["sampler"] == "importance"
    assert tree.attrs["pareto_k"] == drawn.pareto_k
    assert "rhat" not in tree["sample_stats"]
    stats = tree["sample_stats"]["ess"].to_numpy().ravel()
    assert np.array_equal(stats, drawn.ess, equal_nan=True)


#: one that readings determine, and one that lost directions move
SEEN, LOST = "dq1", "da2x"


def head(bounds: dict[str, tuple[float, float]]) -> Measurement:
    """The A3 head with errors of a hundredth, so that its readings are linear."""
    free, every = (-np.inf, np.inf), a3_plans.machine.parameters
    limits = [
        {"tolerance": 0.01 * p.tolerance, "bounds": bounds.get(p.name, free)}
        for p in every
    ]
    parameters = [
        dataclasses.replace(p, **d) for p, d in zip(every, limits, strict=True)
    ]
    return a3_plans.measurement(of=a3_plans.machine.with_parameters(parameters))


def readings() -> tuple[Series, np.ndarray]:
    m = head({})
    series = a3_plans.circles(m, 12)
    rng = np.random.default_rng(6)
    truth = draw_parameters(m, rng)
    return series, draw_readings(m, [series], truth, rng)


SERIES, Y = readings()


def normal_draws(m: Measurement, estimate: Estimate, count: int) -> np.ndarray:
    """Draws (count, n) of the linear Gaussian model without bounds, written out."""
    prior = np.diag(m.tolerance**2)
    h = m.jacobian([SERIES], estimate.theta)
    marginal = h @ prior @ h.T + np.diag(m.sigma([SERIES]) ** 2)
    gain = np.linalg.solve(marginal, h @ prior).T
    change = Y - m.readings([SERIES], estimate.theta) + h @ estimate.theta
    rng = np.random.default_rng(7)
    # Matheron's rule: a draw of the prior, corrected by what it reads
    drawn = rng.standard_normal((count, len(prior))) * m.tolerance
    noise = rng.standard_normal((count, len(Y))) * m.sigma([SERIES])
    return drawn + (change - drawn @ h.T - noise) @ gain.T


@functools.cache
def bounded() -> tuple[Measurement, Estimate, np.ndarray]:
    """Bounds that cut through what is known, and the exact draws within."""
    free = head({})
    first = identify(free, [SERIES], Y)
    seen, lost = (free.names.index(name) for name in (SEEN, LOST))
    ends = {
        SEEN: (-np.inf, max(float(first.theta[seen] + 0.2 * first.sd[seen]), 0.0)),
        LOST: (-0.5 * free.tolerance[lost], np.inf),
    }
    m = head(ends)
    estimate = identify(m, [SERIES], Y)
    exact = normal_draws(m, estimate, 60_000)
    within = (exact[:, seen] <= ends[SEEN][1]) & (exact[:, lost] >= ends[LOST][0])
    assert 0.1 < within.mean() < 0.7
    return m, estimate, exact[within]


@pytest.mark.parametrize("sampler", ["laplace", "auto", "emcee"])
def test_draws_are_those_of_exact_rejection(sampler):
    m, estimate, exact = bounded()
    rng = np.random.default_rng(8)
    if sampler == "laplace":
        drawn = posterior.draw_approximation(m, [SERIES], Y, estimate, rng, 4000).theta
        assert len(drawn) == 4000
    else:
        result = posterior.sample(
            m, [SERIES], Y, estimate, rng, sampler=sampler, ess=1000.0
        )
        drawn = result.pooled
        assert result.sampler == ("emcee" if sampler == "emcee" else "importance")
        most = 0.9 if sampler == "emcee" else 1.0
        assert np.nanmin(result.ess) <= most * drawn.shape[0]
    assert m.in_bounds(drawn).all()
    free = m.free
    sd = exact.std(axis=0)[free]
    off = (drawn.mean(axis=0) - exact.mean(axis=0))[free] / sd
    assert np.abs(off).max() < 0.12
    assert drawn.std(axis=0)[free] == pytest.approx(sd, rel=0.1)
    # without the bounds, the mean of the one that is cut is elsewhere
    cut = m.names.index(SEEN)
    shift = (estimate.theta[cut] - exact[:, cut].mean()) / exact[:, cut].std()
    assert shift > 0.5


def test_an_estimate_near_a_bound_says_so():
    _, estimate, _ = bounded()
    (sentence,) = [w for w in estimate.warnings if "near a bound" in w]
    assert SEEN in sentence
    assert not [w for w in identify(head({}), [SERIES], Y).warnings if "bound" in w]


def test_virtual_machines_keep_to_bounds():
    m = head({SEEN: (0.0, np.inf), LOST: (-1e-6, 2e-6)})
    drawn = draw_parameters(m, np.random.default_rng(9), 2000)
    assert m.in_bounds(drawn).all()
    half_normal = m.tolerance[m.names.index(SEEN)] * np.sqrt(2.0 / np.pi)
    assert drawn[:, m.names.index(SEEN)].mean() == pytest.approx(half_normal, rel=0.06)


def test_readings_that_contradict_bounds_are_refused():
    """The cup is 25 standard deviations on the other side."""
    m = head({})
    (setup,) = m.setups.values()
    nuisances = [dataclasses.replace(n, bounds=(0.0, np.inf)) for n in setup.nuisances]
    m = m.with_setups([dataclasses.replace(setup, nuisances=tuple(nuisances))])
    estimate = identify(m, [SERIES], Y)
    rng = np.random.default_rng(1)
    for sampler in (posterior.sample, posterior.draw_approximation):
        with pytest.raises(OutOfBoundsError, match=r"bounds of cup\.cup_"):
            sampler(m, [SERIES], Y, estimate, rng)


problem_once = functools.cache(functools.partial(problem, distances=False))


def checks_of(residual: np.ndarray, seed: int = 1) -> dict[str, Any]:
    """Checks where the posterior is one point, off the readings by residuals (N,)."""
    m, series, _, estimate = problem_once()
    y = m.readings(series, estimate.theta) + residual * m.sigma(series)
    posterior: Any = SimpleNamespace(pooled=np.tile(estimate.theta, (2000, 1)))
    rng = np.random.default_rng(seed)
    return predictive_checks(m, series, y, estimate, posterior, rng)


@pytest.mark.parametrize("size", [0.8, 1.0, 1.2])
def test_shares_of_rms_and_largest_are_those_of_normal_noise(size):
    """Chi-squared, and the largest of independent normal errors; 400 draws."""
    n = len(problem_once()[2])
    residual = size * np.where(np.arange(n) % 2, 1.0, -1.0)
    checks = checks_of(residual)
    rms, largest = checks["rms"], checks["largest"]
    assert (rms.observed, largest.observed) == pytest.approx((size, size), rel=1e-5)
    chi2 = stats.chi2(n)
    assert rms.p_high == pytest.approx(chi2.sf(n * size**2), abs=0.08)
    assert rms.low == pytest.approx(np.sqrt(chi2.ppf(0.025) / n), rel=0.08)
    assert rms.high == pytest.approx(np.sqrt(chi2.ppf(0.975) / n), rel=0.08)
    within = (2.0 * stats.norm.cdf(size) - 1.0) ** n
    assert largest.p_high == pytest.approx(1.0 - within, abs=0.05)
    assert not rms.alarming
    assert checks_of(5.0 * residual)["rms"].alarming


def test_discrepancies_are_their_formulas():
    m, series, _, estimate = problem_once()
    structure = reading_structure(m, series, estimate.theta)
    n = len(structure)
    errors = np.random.default_rng(2).standard_normal((3, n))
    values = {name: one(structure, errors) for name, one in DISCREPANCIES.items()}
    assert values["rms"] == pytest.approx(np.sqrt((errors**2).mean(axis=1)))
    assert values["largest"] == pytest.approx(np.abs(errors).max(axis=1))
    chains = [np.flatnonzero(structure.chain == c) for c in range(len(structure.run))]
    products = []
    for chain in chains:
        ordered = errors[:, chain[np.argsort(structure.position[chain])]]
        products.append(ordered[:, 1:] * ordered[:, :-1])
    joined = np.hstack(products)
    if joined.size:
        expected = joined.mean(axis=1) / (errors**2).mean(axis=1)
        assert values["neighbours"] == pytest.approx(expected)
    if len(chains) > 1:
        means = np.array([errors[:, c].mean(axis=1) for c in chains])
        expected = np.sqrt((means**2).mean(axis=0))
        assert values["run_means"] == pytest.approx(expected)


COUNT = 600  #: readings of a circle
Session = tuple[Measurement, list[Series]]


def circles() -> Session:
    """Two circles by a ball bar."""
    bar = mount(ball_bar.instrument, "bar", teach=(1.286, 0.0, 0.0))
    m = Measurement(a3_head.machine, [bar])
    psi = np.linspace(-np.pi, np.pi, COUNT, endpoint=False)
    commands = [
        np.column_stack([np.full(COUNT, z), psi, np.full(COUNT, 0.4)])
        for z in (1.146, 1.226)
    ]
    return m, [m.series("bar", c, run=[str(k)] * COUNT) for k, c in enumerate(commands)]


def circles_with_effect() -> Session:
    """The same with an effect whose columns jump from reading to reading."""
    m, series = circles()
    rng = np.random.default_rng(3)
    columns = 2e-6 * rng.choice([-1.0, 1.0], (2 * COUNT, 2))
    offset = 1e-6 * rng.standard_normal(2 * COUNT)
    sizes = np.array([1.0, 0.5])
    return MeasurementWithEffects(m, series, "ab", sizes, columns, offset), series


def scattered() -> Session:
    """A delta read by its probe at random places."""
    m = Measurement(linear_delta.machine, [mount(height_probe.instrument, "probe")])
    rng = np.random.default_rng(4)
    places = rng.uniform(-0.08, 0.08, (2 * COUNT, 2))
    commands = np.column_stack([places, np.full(2 * COUNT, 0.02)])
    return m, [m.series("probe", commands)]


@functools.cache
def fitted(kind: Callable[[], Session]) -> tuple[Measurement, list[Series], Array, Any]:
    """A session, simulated readings and their estimate."""
    m, series = kind()
    rng = np.random.default_rng(5)
    truth = draw_parameters(m, rng)
    sigma = m.sigma(series)
    y = m.readings(series, truth) + sigma * rng.standard_normal(len(sigma))
    return m, series, y, identify(m, series, y, estimate_noise=True)


@pytest.mark.parametrize("kind", [circles, circles_with_effect])
def test_the_density_of_traces_is_that_of_all_readings(kind):
    """The difference in the density is what the exact solver leaves."""
    target = LogDensity(*fitted(kind))
    rng = np.random.default_rng(6)
    points = target.starts(rng, 30)
    interpolated = target(points)
    readings = target._readings
    assert isinstance(readings, log_density.InterpolatedReadings)
    assert len(readings.rows) < 0.15 * 2 * COUNT
    target.__dict__["_readings"] = target._exact
    assert interpolated == pytest.approx(target(points), abs=1e-3)
    theta = target.coordinates.to_theta(points[:, : target.r])
    error = np.abs(readings(theta) - target._exact(theta))
    assert error.max() < 1e-4 * target._noise.sigma.min()


def test_lost_directions_are_followed_as_by_all_readings():
    target = LogDensity(*fitted(circles))
    rng = np.random.default_rng(7)
    null = target.coordinates.null_basis
    theta = target.coordinates.to_theta(target.starts(rng, 20)[:, : target.r])
    change = rng.standard_normal((20, null.shape[1])) @ null.T
    moved = target.move_along_null(theta, change)
    target.__dict__["_readings"] = target._exact
    exact = target.move_along_null(theta, change)
    tolerance = np.where(target.measurement.free, target.measurement.tolerance, 1.0)
    assert moved / tolerance == pytest.approx(exact / tolerance, abs=1e-4)


def test_what_readings_hardly_determine_stays_within_its_prior():
    """Second-order changes are not divided by a slope that is next to nothing."""
    target = LogDensity(*fitted(circles))
    rng = np.random.default_rng(7)
    coordinates = target.coordinates
    weak = target._slope.copy()
    weak[:, -1] *= 1e-9
    target._slope = weak
    theta = coordinates.to_theta(target.starts(rng, 20)[:, : target.r])
    change = rng.standard_normal((20, coordinates.null_basis.shape[1]))
    moved = target.move_along_null(theta, change @ coordinates.null_basis.T)
    steps = (moved - theta - change @ coordinates.null_basis.T) @ coordinates.dual.T
    assert np.abs(steps[:, -1]).max() < 1.0


def test_random_places_are_interpolated_as_exactly_or_not_at_all():
    target = LogDensity(*fitted(scattered))
    points = target.starts(np.random.default_rng(8), 20)
    theta = target.coordinates.to_theta(points[:, : target.r])
    error = np.abs(target._readings(theta) - target._exact(theta))
    assert error.max() < 1e-4 * target._noise.sigma.min()


def test_few_readings_are_exact():
    points = np.zeros((3, 2))

    def exact(theta: Array) -> Array:
        return np.tile(theta.sum(axis=1, keepdims=True), (1, 10))

    readings = log_density.interpolate(exact, lambda rows: exact, points, np.ones(10))
    assert readings is exact
