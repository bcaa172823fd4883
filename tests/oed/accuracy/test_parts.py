"""Acceptance limits, exact errors, means over machines and Monte Carlo errors against closed forms."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from shipped_models import planar_2dof, relative

from oed.acceptance import Promise
from oed.accuracy import (
    BudgetModel,
    ErrorMaps,
    Spread,
    prediction,
    variance_over_machines,
)
from oed.instrument import mount
from oed.measurement import Measurement, draw_parameters
from oed.mechanism import AssemblyError


def test_limits_and_power_of_an_even_error_are_those_of_chi_squared(rng):
    """An error that is the same at all poses, of 2 um, read to 1 um at 6 of 10."""
    size, uncertainty, count = 2e-6, 1e-6, 6
    stated = {"rms": np.array([size]), "uncertainty": np.array([uncertainty])}
    promise = Promise(("z",), np.ones((10, 1, 1)), [np.eye(1)], **stated)
    plan = promise.limits_at(np.arange(count), rng, miss=1.5, false_alarm=0.1)
    at_promise, beyond = (
        stats.ncx2(count, count * (factor * size / uncertainty) ** 2)
        for factor in (1.0, 1.5)
    )
    limit = at_promise.isf(0.1)
    assert plan.limits[0] == pytest.approx(
        uncertainty * np.sqrt(limit / count), rel=0.01
    )
    assert plan.power[0] == pytest.approx(beyond.sf(limit), abs=0.02)
    assert plan.false_alarm == pytest.approx(0.1, abs=1e-3)


def test_machines_that_do_not_assemble_are_left_out(rng):
    """Against the maps about each machine that assembles at all commands."""
    wide = [
        dataclasses.replace(p, tolerance=20.0 * p.tolerance)
        for p in planar_2dof.machine.parameters
    ]
    machine = planar_2dof.machine.with_parameters(wide)
    m = Measurement(machine, [mount(relative.rm5, "ruler")])
    # 8 mm before the second strut is level; its length is known to 10 mm
    command = np.array([[1.55, 0.2], [0.5, 0.2]])
    series = [m.series("ruler", np.array([[0.0, 0.2], [0.5, 0.2]]), run=["a"] * 2)]
    seed = int(rng.integers(1000))
    drawn = variance_over_machines(
        m, series, command, ["home"], np.random.default_rng(seed)
    )["home"]
    variances = []
    for truth in draw_parameters(m, np.random.default_rng(seed), 48):
        p = truth[: len(machine.parameters)]
        try:
            raw = ErrorMaps.of(m.kinematics, command, "home", parameters=p).raw
            covariance = BudgetModel.of(m, series, truth).covariance()
        except AssemblyError:
            continue
        variances.append(np.einsum("nkp,pq,nkq->nk", raw, covariance, raw))
    assert 24 <= len(variances) < 48
    assert drawn == pytest.approx(np.mean(variances, axis=0), rel=1e-6)


MACHINES, POSES, SAMPLES = 2000, 5, 200


@pytest.mark.parametrize("share", [0.025, 0.5, 0.95])
def test_a_quantile_of_normal_numbers(share, rng):
    """sqrt(p (1 - p) / m) over the density, of David and Nagaraja 2003."""
    exact = np.sqrt(share * (1.0 - share) / MACHINES)
    exact /= stats.norm.pdf(stats.norm.ppf(share))
    drawn = [
        prediction.quantile(rng.standard_normal(MACHINES), share)
        for _ in range(SAMPLES)
    ]
    values, errors = np.array(drawn).T
    assert np.mean(errors) == pytest.approx(exact, rel=0.05)
    assert np.std(values) == pytest.approx(exact, rel=0.2)


def test_poses_of_one_machine_are_no_independent_draws(rng):
    """Errors of a machine that all its poses share: five poses count as one."""
    pooled, squares = [], []
    for _ in range(SAMPLES):
        errors = np.tile(rng.standard_normal((400, 1)), POSES)
        pooled.append(prediction.pooled_quantile(np.abs(errors), 0.95))
        squares.append(prediction.root_mean_square(errors))
    for drawn in (pooled, squares):
        values, errors = np.array(drawn).T
        assert np.mean(errors) == pytest.approx(np.std(values), rel=0.2)
    # rms of 400 normal numbers: sd 1 / sqrt(2 m)
    assert np.mean(np.array(squares)[:, 1]) == pytest.approx(800**-0.5, rel=0.05)


def test_draws_of_a_chain_are_worth_less(rng):
    values = rng.standard_normal(MACHINES)
    alone = prediction.quantile(values, 0.5)
    related = prediction.quantile(values, 0.5, worth=MACHINES / 4)
    assert related.value == alone.value
    assert related.error == pytest.approx(2.0 * alone.error, rel=0.2)


def test_every_drawn_figure_of_a_spread_has_its_error(rng):
    size = np.abs(rng.standard_normal((MACHINES, 1)))
    spreads = [
        Spread.of_errors(size * rng.standard_normal((MACHINES, POSES)))
        for _ in range(2)
    ]
    for name, errors in spreads[0].monte_carlo.items():
        first, second = (np.atleast_1d(getattr(s, name)) for s in spreads)
        assert len(errors) == len(first)
        assert (np.array(errors) > 0.0).all()
        assert (np.abs(first - second) < 5.0 * np.sqrt(2.0) * np.array(errors)).all()
    whole = Spread.of_errors(np.zeros((10, 3)))
    assert set(whole.monte_carlo.values()) == {(0.0,), (0.0, 0.0)}
