"""Readings as a problem of the fitter against the oracle's gantry and differences."""

import numpy as np
import pytest
from oracles import planar_geometry
from shipped_models import planar_2dof, pose_tracker

from oed.estimation.coordinates import ReadingsProblem
from oed.instrument import mount
from oed.measurement import Measurement

position = pose_tracker.position

COMMAND = np.array([[0.0, 0.5], [1.0, 0.4], [-0.8, 1.1]])


def problem(rng: np.random.Generator) -> ReadingsProblem:
    """Two gantries, read at three places, over four directions of all parameters."""
    m = Measurement(planar_2dof.machine, [mount(position, "tracker")])
    series = [m.series("tracker", COMMAND)]
    origin = m.nominal + m.tolerance * rng.standard_normal((2, len(m.nominal)))
    basis = m.tolerance[:, None] * rng.standard_normal((len(m.nominal), 4))
    noise = m.noise(series)
    y = m.readings(series, origin) + 1e-5 * rng.standard_normal((2, len(noise.sigma)))
    return ReadingsProblem(m, series, noise, y, origin, basis)


def test_residuals_are_those_of_the_oracles_poses(rng: np.random.Generator) -> None:
    """Of gantries whose tracker stands where it is assumed to."""
    p, z = problem(rng), rng.standard_normal((1, 4))
    p.origin[:, 7:] = p.basis[7:] = 0.0
    theta = p.theta(np.array([1]), z)
    assert theta[0] == pytest.approx(p.origin[1] + p.basis @ z[0])
    (series,) = p.series
    pose = planar_geometry.forward(series.q, theta[0, :7])
    at = np.column_stack([np.zeros(3), pose])
    exact = (p.y[1].reshape(3, 3) - at) / p.noise.sigma.reshape(3, 3)
    residuals = p.residuals(np.array([1]), z)[0].reshape(3, 3)
    assert residuals == pytest.approx(exact, abs=1e-5)


def test_slopes_are_differences_of_residuals(rng: np.random.Generator) -> None:
    p, z, machines = problem(rng), rng.standard_normal((2, 4)), np.arange(2)
    slopes, step = p.slopes(machines, z), 1e-4
    for k, change in enumerate(step * np.eye(4)):
        ahead = p.residuals(machines, z + change)
        behind = p.residuals(machines, z - change)
        exact = -(ahead - behind) / (2.0 * step)
        assert slopes[:, :, k] == pytest.approx(exact, abs=1e-4 * np.abs(slopes).max())


def test_magnitude_is_that_of_the_larger_of_reading_and_machine(
    rng: np.random.Generator,
) -> None:
    p = problem(rng)
    assert p.magnitude.shape == p.y.shape
    size = p.magnitude * p.noise.sigma
    assert (size >= np.abs(p.y)).all()
    assert (size < 2e3).all()
