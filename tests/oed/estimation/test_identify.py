"""Identification: the linear closed form, the oracle's objective, many machines at once."""

import functools
import re

import numpy as np
import pytest
from oracles import a3_geometry as a3
from scipy import stats
from shipped_models import calliper, height_probe, linear_delta

from kernel import a3_plans
from kernel.cases import CASES
from oed.estimation import (
    Estimate,
    IdentifiableCoordinates,
    IdentificationError,
    fit_machines,
    identification,
    identify,
)
from oed.instrument import mount
from oed.measurement import Measurement, Series, draw_parameters

NOISE = 0.5e-6


@pytest.fixture(scope="module")
def bar() -> tuple[Measurement, Series]:
    m = a3_plans.measurement()
    return m, a3_plans.circles(m, 15)


@pytest.fixture(scope="module")
def printer() -> tuple[Measurement, list[Series]]:
    """Heights and calliper distances on a delta."""
    probe = mount(height_probe.instrument, "probe")
    both = [probe, mount(calliper.instrument, "calliper")]
    m = Measurement(linear_delta.machine, both)
    rng = np.random.default_rng(9)
    flat = CASES["linear_delta"].commands(rng, 34) * [1, 1, 0] + [0, 0, 0.02]
    return m, [m.series("probe", flat[:20]), m.series("calliper", flat[20:])]


def oracle_readings(series: Series, theta: np.ndarray) -> np.ndarray:
    """Bar lengths by the oracle, for theta (..., 27); complex theta passes through."""
    cup = a3.taught_cup(theta[..., :24], theta[..., 24:])
    return a3.ball_bar_reading(
        theta[..., None, :24], series.q[series.index[:, 0]], cup[..., None, :]
    )


def noisy(series: Series, theta: np.ndarray, seed: int) -> np.ndarray:
    return oracle_readings(series, theta) + NOISE * np.random.default_rng(
        seed
    ).standard_normal(len(series))


def test_small_errors_give_the_linear_closed_form(bar):
    """theta = T (I + Q^T Q)^-1 Q^T (y - y0) / sigma, Q from the oracle's rows."""
    m, series = bar
    truth = 1e-4 * m.tolerance * np.random.default_rng(1).standard_normal(27)
    y = noisy(series, truth, 2)
    command = series.reading_commands()
    q = a3.bar_rows(*command.T, np.array([0, 0, a3.Z_TEACH])) * m.tolerance / NOISE
    gain = np.linalg.inv(np.eye(27) + q.T @ q)
    found = identify(m, [series], y)
    posterior = gain * np.outer(m.tolerance, m.tolerance)
    miss = found.theta - m.tolerance * (gain @ q.T @ ((y - a3.BAR) / NOISE))
    assert np.abs(miss[m.free] / np.sqrt(np.diag(posterior))[m.free]).max() < 0.01
    assert found.covariance == pytest.approx(
        posterior, rel=1e-2, abs=1e-3 * posterior.max()
    )
    assert found.sd == pytest.approx(np.sqrt(np.diag(posterior)), rel=1e-2, abs=1e-9)
    assert found.dof == pytest.approx(30 - np.trace(q @ gain @ q.T), abs=1e-3)
    assert found.shrinkage[m.free] == pytest.approx(
        np.sqrt(np.diag(gain))[m.free], rel=1e-2
    )
    assert (found.shrinkage[~m.free] == 0).all()
    assert (found.scatter, found.widening) == (1.0, 1.0)  # the law is not contradicted


@pytest.mark.parametrize("seed", range(3))
def test_large_errors_end_at_the_minimum_of_the_oracles_objective(bar, seed):
    """The gradient by the oracle's complex step: nought, against thousands at the start."""
    m, series = bar
    truth = m.tolerance * np.random.default_rng(seed).standard_normal(27)
    y = noisy(series, truth, seed)

    def gradient(theta: np.ndarray) -> np.ndarray:
        moved = oracle_readings(series, theta + 1e-30j * np.eye(27))
        white = (moved[0].real - y) / NOISE
        slope = moved.imag / 1e-30 / NOISE * m.tolerance[:, None]
        prior = np.divide(theta, m.tolerance, out=np.zeros(27), where=m.free)
        return 2 * (slope @ white + prior)[m.free]

    found = identify(m, [series], y)
    assert np.abs(gradient(m.nominal)).max() > 1e4
    assert np.abs(gradient(found.theta)).max() < 0.05
    assert (found.theta[~m.free] == 0).all()
    assert found.residuals == pytest.approx(
        y - oracle_readings(series, found.theta), abs=1e-12
    )
    assert found.residuals_before == pytest.approx(y - a3.BAR, abs=1e-12)
    assert found.chi2 == pytest.approx(np.sum((found.residuals / NOISE) ** 2))
    assert found.stages[-1].rms_after == pytest.approx(np.sqrt(found.chi2 / 30))
    assert found.stages[0].rms_before > 100


def test_coordinates_split_theta_into_seen_and_unseen(bar, printer):
    """at() undoes theta() and drops unseen moves; both parts are orthonormal."""
    probe = Measurement(linear_delta.machine, [mount(height_probe.instrument, "probe")])
    flat = CASES["linear_delta"].commands(np.random.default_rng(9), 20)
    flat = flat * [1, 1, 0] + [0, 0, 0.02]
    rng = np.random.default_rng(5)
    for m, series, unseen in (
        (bar[0], [bar[1]], 3),
        (*printer, 1),
        (probe, [probe.series("probe", flat)], 1),
    ):
        local = IdentifiableCoordinates.of(m, series, m.nominal, m.sigma(series))
        assert local.null_basis.shape[1] == unseen
        n, r = local.basis.shape
        assert r + unseen == m.free.sum()
        both = (
            np.hstack([local.basis, local.null_basis])[m.free]
            / m.tolerance[m.free, None]
        )
        assert both.T @ both == pytest.approx(np.eye(r + unseen), abs=1e-9)
        white = m.jacobian(series, m.nominal) / m.sigma(series)[:, None]
        assert np.abs(white @ local.null_basis).max() < 1e-4
        z, w = rng.standard_normal((4, r)), rng.standard_normal(unseen)
        theta = local.to_theta(z)
        assert theta.shape == (4, n)
        for k in range(4):
            for unseen_move in (0.0, local.null_basis @ w):
                found = local.from_theta(theta[k] + unseen_move)
                assert found == pytest.approx(z[k], abs=1e-9)


def test_rough_before_fine(bar):
    m, series = bar
    truth = a3_plans.table_3(m)
    y = noisy(series, truth, 7)
    once = identify(m, [series], y)
    staged = identify(m, [series], y, stages=[["dq*"], ["*"]])
    assert [r.patterns for r in staged.stages] == [("dq*",), ("*",)]
    assert staged.stages[0].rms_after < staged.stages[0].rms_before
    assert staged.stages[1].rms_before == pytest.approx(
        staged.stages[0].rms_after, rel=1e-9
    )
    assert staged.stages[1].rms_after < staged.stages[1].rms_before
    # the same minimum, up to where the lost directions were frozen
    assert m.readings([series], staged.theta) == pytest.approx(
        m.readings([series], once.theta), abs=NOISE
    )
    seen = once.coordinates
    assert seen.from_theta(staged.theta) == pytest.approx(
        seen.from_theta(once.theta), abs=0.05
    )


def test_only_what_is_freed_moves(bar):
    m, series = bar
    start = m.nominal + 1e-5
    y = noisy(series, a3_plans.table_3(m), 8)
    found = identify(m, [series], y, stages=[["dq*", "*.cup_z"]], start=start)
    moved = [n for n, a, b in zip(m.names, found.theta, start, strict=True) if a != b]
    assert moved == ["dq1", "dq2", "dq3", "cup.cup_z"]
    assert [n for n, sd in zip(m.names, found.prior_sd, strict=True) if sd] == moved


def test_understated_noise_is_estimated(printer):
    """Heights three times as noisy as stated, distances as stated."""
    m, series = printer
    scales, chances = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = draw_parameters(m, rng)
        exact, sigma = m.readings(series, truth), m.sigma(series)
        actual = np.where(np.arange(len(sigma)) < 20, 3.0, 1.0) * sigma
        y = exact + actual * rng.standard_normal(len(sigma))
        estimate = identify(m, series, y, estimate_noise=True)
        scales.append(total_noise(estimate))
        chances.append(stats.chi2.sf(estimate.chi2, estimate.dof))
    heights, distances = np.median(scales, axis=0)
    assert heights / distances == pytest.approx(3.0, rel=0.25)
    assert 2.4 < heights < 4.0
    assert np.max(chances) < 1e-3


def total_noise(estimate: Estimate) -> list[float]:
    """Standard deviation of each group's readings over the stated one, mean of laws."""
    posterior = estimate.noise_posterior
    laws = posterior.prior.laws(posterior.draws)
    total = laws.scale * np.sqrt(1.0 + laws.level**2)[:, None]
    return list(posterior.weights @ total)


def test_a_perfect_fit_keeps_the_estimate_and_is_suspicious(printer):
    m, series = printer
    estimate = identify(m, series, m.readings(series, m.nominal), estimate_noise=True)
    assert estimate.theta == pytest.approx(m.nominal, abs=1e-9)
    assert stats.chi2.cdf(estimate.chi2, estimate.dof) < 1e-6


@pytest.mark.parametrize(("spoil", "told"), [
    (lambda y: y[:-1], r"30 readings were planned, \(29,\) are given"),
    (lambda y: np.where(np.arange(30) == 3, np.nan, y), r"readings number \[3\] are not finite"),
    (lambda y: np.where(np.arange(30) == 3, np.inf, y), r"readings number \[3\] are not finite"),
])  # fmt: skip
def test_unusable_readings_are_refused(bar, spoil, told):
    m, series = bar
    with pytest.raises(IdentificationError, match=told):
        identify(m, [series], spoil(np.full(30, 0.3)))


@pytest.mark.parametrize("stages", [[["q*"]], [["q*"], ["*"]], [["db1x"]], [[]]])
def test_patterns_that_free_nothing_are_refused(bar, stages):
    m, series = bar
    with pytest.raises(
        IdentificationError,
        match=re.escape(f"the patterns {stages[0]} free no parameter of"),
    ):
        identify(m, [series], np.full(30, 0.3), stages=stages)


def test_a_fit_that_runs_out_of_iterations_says_so(bar):
    m, series = bar
    with pytest.raises(
        IdentificationError, match=r"did not converge in 2 iterations.*check units"
    ):
        identify(m, [series], noisy(series, a3_plans.table_3(m), 1), max_iterations=2)


def test_warnings_name_what_is_doubtful(bar):
    m, series = bar
    truth = a3_plans.table_3(m)
    truth[0] += 8e-3  # eight tolerances
    y = noisy(series, truth, 1)
    y[4] += 50e-6  # a hundred sigma
    told = identify(m, [series], y).warnings
    assert any("more than 4 tolerances" in t and "dq1" in t for t in told)
    assert any("times the stated noise" in t for t in told)
    shrinkage = identify(m, [series], y).shrinkage
    lost = {n for n, s in zip(m.names, shrinkage, strict=True) if s > 0.7}
    assert any(all(n in t for n in lost) for t in told)


def test_two_set_ups_are_fitted_together():
    """Two tool lengths see every direction but the spin's; each set-up has its own cup."""
    m = a3_plans.measurement(taught=False, tools=(0.0, 0.1))
    series = [a3_plans.circles(m, 15), a3_plans.circles(m, 15, "cup100")]
    rng = np.random.default_rng(3)
    truth = m.tolerance * rng.standard_normal(30)
    y = []
    for s, tool, offset in zip(
        series, (0.0, 0.1), (truth[24:27], truth[27:]), strict=True
    ):
        cup = np.array([0, 0, a3.Z_TEACH + tool]) + offset
        y.append(
            a3.ball_bar_reading(truth[:24], s.q, cup, tool)
            + NOISE * rng.standard_normal(30)
        )
    found = identify(m, series, np.concatenate(y))
    assert found.coordinates.null_basis.shape[1] == 1
    assert found.chi2 < found.dof + 5 * np.sqrt(2 * found.dof)
    z = found.coordinates.from_theta(truth) - found.z
    h = found.noise.whiten(m.jacobian(series, found.theta)) @ found.coordinates.basis
    precision = np.eye(len(z)) + h.T @ h
    assert z @ precision @ z < len(z) + 5 * np.sqrt(2 * len(z))


STAGES = (("dq*",), ("*",))


def oracle_sessions(m: Measurement, series: Series, machines: int) -> np.ndarray:
    """Readings (machines, N) that the oracle makes, with white noise."""
    rng = np.random.default_rng(3)
    theta = draw_parameters(m, rng, machines)
    joints = series.q[series.index[:, 0]]
    cups = a3.taught_cup(theta[:, :24], theta[:, 24:])
    exact = a3.ball_bar_reading(theta[:, None, :24], joints, cups[:, None, :])
    return exact + NOISE * rng.standard_normal(exact.shape)


@pytest.mark.parametrize("stages", [(("*",),), STAGES], ids=["at once", "staged"])
def test_machines_end_where_one_fit_after_the_other_does(bar, stages):
    m, series = bar
    y = oracle_sessions(m, series, 4)
    together = fit_machines(m, [series], y, stages=stages)
    for theta, readings in zip(together, y, strict=True):
        alone = identify(m, [series], readings, stages=stages)
        deviation = np.sqrt(np.diag(alone.covariance))
        change = np.abs(theta - alone.theta)[m.free] / deviation[m.free]
        assert change.max() < 1e-4


def test_batches_of_any_size_agree(bar, monkeypatch):
    m, series = bar
    y = oracle_sessions(m, series, 3)
    together = fit_machines(m, [series], y)
    monkeypatch.setattr(identification, "BATCH_ENTRIES", 1)
    one_by_one = fit_machines(m, [series], y)
    scale = np.where(m.free, m.tolerance, 1.0)
    np.testing.assert_allclose(one_by_one / scale, together / scale, rtol=0, atol=1e-6)


def test_rounding_at_the_minimum_keeps_no_machine_from_converging(bar, monkeypatch):
    m, series = bar

    def unneeded(*_: object, **__: object) -> None:
        raise AssertionError("a machine was fitted alone")

    monkeypatch.setattr(identification, "identify", unneeded)
    fit_machines(m, [series], oracle_sessions(m, series, 20), stages=STAGES)


def test_what_does_not_converge_is_fitted_alone(bar, monkeypatch):
    m, series = bar
    y = oracle_sessions(m, series, 1)
    one_step = functools.partial(identification.minimise, steps=1)
    monkeypatch.setattr(identification, "minimise", one_step)
    theta = fit_machines(m, [series], y)[0]
    assert (theta == identify(m, [series], y[0]).theta).all()
