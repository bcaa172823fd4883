"""The sampler: Laplace where the problem is linear, quadrature where it is not."""

import numpy as np
import pytest
import xarray as xr
from scipy import special

from kernel import a3_plans
from kernel.delta_probe import problem
from oed import posterior, safe_files
from oed.estimation import identify
from oed.measurement import draw_readings
from oed.posterior import LogDensity, log_density


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
