"""Predictions of readings by the others: against fits without each reading."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oed import Measurement, mount
from oed.estimation import identify
from oed.estimation.left_out import left_out_errors
from oed.measurement import draw_parameters, draw_readings
from pkm_models.instruments.pose_tracker import position
from pkm_models.machines.planar_2dof import machine


def test_each_error_is_that_of_a_fit_without_the_reading() -> None:
    measurement = Measurement(machine, [mount(position, "tracker")])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 3), np.linspace(0.2, 1.3, 3))
    series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    rng = np.random.default_rng(1)
    truth = draw_parameters(measurement, rng)
    readings = draw_readings(measurement, [series], truth, rng)
    estimate = identify(measurement, [series], readings)
    errors = left_out_errors(measurement, [series], estimate).reshape(9, 3)
    for k in (0, 4, 7):
        others = np.delete(np.arange(9), k)
        rest = series.take(others)
        values = readings.reshape(9, 3)[others].ravel()
        without = identify(measurement, [rest], values, start=estimate.theta)
        predicted = measurement.readings([series.take(np.array([k]))], without.theta)
        error = readings.reshape(9, 3)[k] - predicted
        assert errors[k] == pytest.approx(error, rel=0.02, abs=1e-8)


def test_noise_that_effects_follow_is_not_predicted() -> None:
    """A model with as many free columns as readings fits all, and predicts none."""
    measurement = Measurement(machine, [mount(position, "tracker")])
    series = measurement.series(
        "tracker", np.array([[-1.0, 0.5], [0.0, 0.9], [1.0, 0.4]])
    )
    readings = measurement.readings([series], measurement.nominal)
    rng = np.random.default_rng(2)
    noisy = readings + 1e-3 * rng.standard_normal(len(readings))
    estimate = identify(measurement, [series], noisy)
    loose = dataclasses.replace(estimate, noise=type(estimate.noise)(1e-3 * np.ones(9)))
    errors = left_out_errors(measurement, [series], loose)
    assert np.sqrt(np.mean(errors**2)) > 0.5e-3
