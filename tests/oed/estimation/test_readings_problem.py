"""Readings as a problem of the fitter against the oracle's gantry and differences."""

import numpy as np
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


def test_magnitude_is_that_of_the_larger_of_reading_and_machine(rng):
    p = problem(rng)
    assert p.magnitude.shape == p.y.shape
    size = p.magnitude * p.noise.sigma
    assert (size >= np.abs(p.y)).all()
    assert (size < 2e3).all()
