"""Readings that scatter more than their instrument is stated to."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from shipped_models import encoder_scale, planar_2dof, pose_tracker

from oed import Measurement, mount
from oed.gap import diagnose, prepare
from oed.gap.data.diagnosis import Diagnosis

effect = encoder_scale.effect
position = pose_tracker.position
machine = planar_2dof.machine

SIGMA = 10e-6


def diagnosis(factor: float, *, assumed: bool = False) -> Diagnosis:
    """Of 48 poses whose readings scatter a factor of the stated noise, without effects."""
    setup = mount(position, "tracker", sigma=(SIGMA,) * 3)
    statement = dataclasses.replace(setup.statement, is_assumed=assumed)
    setup = dataclasses.replace(setup, statement=statement)
    measurement = Measurement(machine, [setup])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 8), np.linspace(0.2, 1.3, 6))
    runs = np.repeat([str(k) for k in range(6)], 8)
    command = np.column_stack([y.ravel(), z.ravel()])
    series = measurement.series("tracker", command, runs)
    rng = np.random.default_rng(7)
    noise = factor * SIGMA * rng.standard_normal(3 * len(command))
    readings = measurement.readings([series], measurement.nominal) + noise
    order = np.tile(np.arange(1, 9), 6)
    rows = {"setup": "tracker", "run": runs, "order": order, "direction": 1}
    covariates = pd.DataFrame(rows)
    problem = prepare(measurement, [series], readings, covariates)
    return diagnose(problem, [effect], rng)


def test_scatter_that_a_data_sheet_is_good_for_is_noise():
    result = diagnosis(1.3)
    assert result.verdict == "none"
    assert result.scatter is None
    assert "compensate the geometry" in result.next[0]


def test_more_scatter_is_reported_with_its_factor_and_no_go_ahead():
    result = diagnosis(3.0)
    assert result.verdict == "scatter"
    assert result.scatter.factor == pytest.approx(3.0, rel=0.2)
    assert result.next[0].startswith("Do not compensate yet: read some poses several")
    assert result.where == ()


def test_an_assumed_noise_is_no_data_sheet():
    assert diagnosis(3.0, assumed=True).verdict == "none"
