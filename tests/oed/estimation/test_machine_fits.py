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
