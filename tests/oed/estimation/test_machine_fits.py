"""Many machines fitted at once: the same minima as one fit after the other."""

import functools

import numpy as np
import pytest
from oracles import a3_geometry as a3

from kernel import a3_plans
from oed.estimation import fit_machines, identification, identify
from oed.measurement import Measurement, Series, draw_parameters

NOISE = 0.5e-6
STAGES = (("dq*",), ("*",))


@pytest.fixture(scope="module")
def bar() -> tuple[Measurement, Series]:
    m = a3_plans.measurement()
    return m, a3_plans.circles(m, 15)


def oracle_sessions(m: Measurement, series: Series, machines: int) -> np.ndarray:
    """Readings (machines, N) that the oracle makes, with white noise."""
    rng = np.random.default_rng(3)
    theta = draw_parameters(m, rng, machines)
    joints = series.q[series.index[:, 0]]
    cups = a3.taught_cup(theta[:, :24], theta[:, 24:])
    exact = a3.ball_bar_reading(theta[:, None, :24], joints, cups[:, None, :])
    return exact + NOISE * rng.standard_normal(exact.shape)


@pytest.mark.parametrize("stages", [(("*",),), STAGES], ids=["at once", "staged"])
def test_machines_end_where_one_fit_after_the_other_does(
    bar: tuple[Measurement, Series], stages: tuple[tuple[str, ...], ...]
) -> None:
    m, series = bar
    y = oracle_sessions(m, series, 4)
    together = fit_machines(m, [series], y, stages=stages)
    for theta, readings in zip(together, y, strict=True):
        alone = identify(m, [series], readings, stages=stages)
        deviation = np.sqrt(np.diag(alone.covariance))
        change = np.abs(theta - alone.theta)[m.free] / deviation[m.free]
        assert change.max() < 1e-4


def test_the_gradient_vanishes_by_the_oracle(bar: tuple[Measurement, Series]) -> None:
    m, series = bar
    y = oracle_sessions(m, series, 2)
    joints = series.q[series.index[:, 0]]
    free = np.flatnonzero(m.free)
    for theta, readings in zip(fit_machines(m, [series], y), y, strict=True):

        def cost(
            u: np.ndarray, at: np.ndarray = theta, y: np.ndarray = readings
        ) -> float:
            moved = at.copy()
            moved[free] += u * m.tolerance[free]
            cup = a3.taught_cup(moved[:24], moved[24:])
            predicted = a3.ball_bar_reading(moved[:24], joints, cup)
            prior = (moved - m.nominal)[free] / m.tolerance[free]
            residual = (y - predicted) / NOISE
            return float(residual @ residual + prior @ prior)

        step = 1e-4 * np.eye(len(free))
        above = np.array([cost(row) for row in step])
        below = np.array([cost(-row) for row in step])
        gradient = (above - below) / 2e-4
        curvature = (above - 2.0 * cost(0.0 * step[0]) + below) / 1e-8
        assert (np.abs(gradient) < 1e-4 * curvature).all()


def test_batches_of_any_size_agree(
    bar: tuple[Measurement, Series], monkeypatch: pytest.MonkeyPatch
) -> None:
    m, series = bar
    y = oracle_sessions(m, series, 3)
    together = fit_machines(m, [series], y)
    monkeypatch.setattr(identification, "BATCH_ENTRIES", 1)
    one_by_one = fit_machines(m, [series], y)
    scale = np.where(m.free, m.tolerance, 1.0)
    np.testing.assert_allclose(one_by_one / scale, together / scale, rtol=0, atol=1e-6)


def test_rounding_at_the_minimum_keeps_no_machine_from_converging(
    bar: tuple[Measurement, Series], monkeypatch: pytest.MonkeyPatch
) -> None:
    m, series = bar

    def unneeded(*_: object, **__: object) -> None:
        raise AssertionError("a machine was fitted alone")

    monkeypatch.setattr(identification, "identify", unneeded)
    fit_machines(m, [series], oracle_sessions(m, series, 20), stages=STAGES)


def test_what_does_not_converge_is_fitted_alone(
    bar: tuple[Measurement, Series], monkeypatch: pytest.MonkeyPatch
) -> None:
    m, series = bar
    y = oracle_sessions(m, series, 1)
    one_step = functools.partial(identification.minimise, steps=1)
    monkeypatch.setattr(identification, "minimise", one_step)
    theta = fit_machines(m, [series], y)[0]
    assert (theta == identify(m, [series], y[0]).theta).all()


def test_slopes_of_several_vectors_are_those_of_each(
    bar: tuple[Measurement, Series],
) -> None:
    m, series = bar
    theta = draw_parameters(m, np.random.default_rng(4), 3)
    rows = m.jacobian([series], theta)
    for k in range(3):
        np.testing.assert_allclose(
            rows[k], m.jacobian([series], theta[k]), rtol=1e-12, atol=1e-12
        )
