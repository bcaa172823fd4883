"""Acceptance limits, exact errors and means over machines against closed forms."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from shipped_models import planar_2dof, relative

from oed.acceptance import Promise
from oed.accuracy import BudgetModel, ErrorMaps, variance_over_machines
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
