"""Readings interpolated from a few of them, against the exact ones."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from shipped_models import a3_head, ball_bar, height_probe, linear_delta

from oed.base import Array
from oed.corrected import MeasurementWithEffects
from oed.estimation import identify
from oed.instrument import mount
from oed.measurement import Measurement, Series, draw_parameters
from oed.posterior import LogDensity, log_density

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
