"""The fitter: closed forms, scipy as an oracle, steps that close, many machines at once."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize
from shipped_models import linear_delta, planar_2dof, pose_tracker

from oed.estimation import (
    IdentificationError,
    Minima,
    identification,
    identify,
    minimise,
)
from oed.estimation.coordinates import ReadingsProblem
from oed.estimation.fit_stages import ReadingsFit
from oed.estimation.fitter import READINGS_TOLERANCE, _Steps
from oed.instrument import mount
from oed.measurement import Measurement
from oed.mechanism import AssemblyError


@dataclasses.dataclass
class Curve:
    """Whitened readings y (m, N) of a model f(z) with slopes, machine by machine."""

    y: np.ndarray
    model: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]

    @property
    def magnitude(self) -> np.ndarray:
        return np.abs(self.y)

    def residuals(self, machines: np.ndarray, z: np.ndarray) -> np.ndarray:
        predicted = np.array([self.model(row) for row in z])
        return self.y[machines] - predicted

    def slopes(self, machines: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.array([self.slope(row) for row in z])


def ridge(weight: np.ndarray) -> tuple[Minima, np.ndarray]:
    """Minimum of a linear model, and its closed form by the normal equations."""
    rng = np.random.default_rng(1)
    a, y = rng.normal(size=(12, 4)), rng.normal(size=(3, 12))
    problem = Curve(y, lambda z: a @ z, lambda z: a)
    exact = np.linalg.solve(a.T @ a + np.diag(weight**2), a.T @ y.T).T
    return minimise(problem, rng.normal(size=(3, 4)), weight=weight), exact


@pytest.mark.parametrize("weight", [1.0, 1e-9, 0.0])
def test_a_linear_model_takes_one_step_to_the_closed_form(weight):
    minima, exact = ridge(np.array([1.0, 1.0, weight, weight]))
    assert minima.converged.all()
    np.testing.assert_allclose(minima.z, exact, rtol=0.0, atol=1e-11)
    assert (minima.evaluations <= 2).all()


@pytest.mark.parametrize(("bend", "most"), [(0.9, 15), (1.9, 15), (8.0, 60)])
def test_steps_that_overshoot_are_damped_until_they_do_not(bend, most):
    """The second residual bends: a Gauss-Newton step overshoots by `bend` times its length."""
    a, c, far = 10.0, 0.5, -100.0
    b = bend * (a**2 + 1.0) / (-2.0 * far)
    problem = Curve(
        np.array([[c, far]]),
        lambda z: np.array([a * z[0], b * z[0] ** 2]),
        lambda z: np.array([[a], [2.0 * b * z[0]]]),
    )
    minima = minimise(problem, np.full((1, 1), 0.2))
    roots = np.roots([2.0 * b**2, 0.0, a**2 + 1.0 - 2.0 * b * far, -a * c])
    (exact,) = roots[np.isreal(roots)].real
    assert minima.converged.all()
    assert minima.z[0, 0] == pytest.approx(exact, abs=1e-9)
    assert minima.evaluations[0] <= most


def decay(z: np.ndarray) -> np.ndarray:
    """A decay of unknown size and rate, in units of the noise."""
    return np.asarray(1e3 * np.exp(z[0] - np.exp(0.5 * z[1]) * np.linspace(0, 2, 20)))


def decay_slope(z: np.ndarray) -> np.ndarray:
    by_rate = -0.5 * np.exp(0.5 * z[1]) * np.linspace(0, 2, 20) * decay(z)
    return np.column_stack([decay(z), by_rate])


def decays(machines: int) -> Curve:
    rng = np.random.default_rng(2)
    true = rng.normal(size=(machines, 2))
    exact = np.array([decay(z) for z in true])
    return Curve(exact + rng.normal(size=exact.shape), decay, decay_slope)


def test_a_curved_model_ends_where_scipy_does():
    problem = decays(8)
    minima = minimise(problem, np.zeros((8, 2)))
    assert minima.converged.all()
    for y, z, slopes in zip(problem.y, minima.z, minima.slopes, strict=True):
        oracle = optimize.least_squares(
            lambda z, y=y: np.concatenate([y - decay(z), z]),
            np.zeros(2),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-13,
        )
        sd = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes + np.eye(2))))
        assert (np.abs(z - oracle.x) < 1e-5 * sd).all()


def test_a_machine_ends_where_it_does_without_others():
    together, problem = minimise(decays(5), np.zeros((5, 2))), decays(5)
    for k in range(5):
        one = dataclasses.replace(problem, y=problem.y[k : k + 1])
        assert np.allclose(minimise(one, np.zeros((1, 2))).z[0], together.z[k], 1e-13)


def test_the_residual_is_that_of_the_minimum():
    problem = decays(4)
    minima = minimise(problem, np.zeros((4, 2)))
    exact = problem.residuals(np.arange(4), minima.z)
    np.testing.assert_allclose(minima.residual, exact, rtol=0.0, atol=1e-9)


def test_an_early_end_is_within_its_precision():
    near = minimise(decays(6), np.zeros((6, 2)), precision=0.1)
    end = minimise(decays(6), np.zeros((6, 2)))
    off = np.linalg.norm((end.slopes @ (near.z - end.z)[:, :, None])[:, :, 0], axis=1)
    assert (off < 0.1).all()
    assert (near.evaluations <= end.evaluations).all()


def test_machines_without_slopes_or_residuals_do_not_stop_the_others():
    problem = decays(3)

    def slope(z: np.ndarray) -> np.ndarray:
        if z[0] == -0.5:
            raise AssemblyError("singular", np.zeros(1, dtype=int))
        return decay_slope(z)

    def model(z: np.ndarray) -> np.ndarray:
        return np.full(20, np.nan) if z[0] == 9.0 else decay(z)

    start = np.array([[-0.5, 0.0], [0.0, 0.0], [9.0, 0.0]])
    minima = minimise(dataclasses.replace(problem, model=model, slope=slope), start)
    assert minima.converged.tolist() == [False, True, False]
    assert np.isfinite(minima.residual).all(axis=1).tolist() == [False, True, False]
    assert np.allclose(minima.z[1], minimise(problem, np.zeros((3, 2))).z[1])


def test_rounding_that_is_allowed_is_that_of_each_machines_own_readings():
    """By hand: residuals that are off by e change sums of r^2 by 2 |r| e at the most."""
    residual = np.array([[3.0, -4.0, 0.0], [10.0, 0.0, 20.0]])
    rounding = np.array([[1e-3, 1e-4, 1.0], [1e-2, 7.0, 1e-5]])
    problem = Rounded(residual, rounding / READINGS_TOLERANCE)
    steps = _Steps(problem, np.zeros((2, 1)), np.ones(1))
    by_hand = np.array([2.0 * (3e-3 + 4e-4), 2.0 * (1e-1 + 2e-4)])
    every = steps._rounding_of_sums(np.arange(2))
    assert every == pytest.approx(by_hand, rel=1e-6)
    for one in range(2):
        assert steps._rounding_of_sums(np.array([one])) == pytest.approx(every[[one]])


@dataclasses.dataclass
class Rounded:
    """Residuals (m, N) that are the same everywhere, with their magnitudes."""

    values: np.ndarray
    magnitude: np.ndarray

    def residuals(self, machines: np.ndarray, z: np.ndarray) -> np.ndarray:
        return self.values[machines]

    def slopes(self, machines: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.zeros((*self.values[machines].shape, z.shape[1]))


position = pose_tracker.position


def test_a_step_to_parameters_that_do_not_close_is_halved():
    """With all lengths turned over nothing closes; near the start all does."""
    measurement = Measurement(linear_delta.machine, [mount(position, "tracker")])
    home = linear_delta.machine.home_command
    series = [measurement.series("tracker", home[None])]
    y = measurement.readings(series, measurement.nominal)
    fit = ReadingsFit(measurement, series, y, measurement.noise(series), 20)
    start = measurement.nominal
    wanted = -2.0 * start
    assert not np.isfinite(measurement.try_readings(series, wanted)).all()
    reached = fit.closing(start, wanted)
    assert np.isfinite(measurement.try_readings(series, reached)).all()
    share = (reached - start)[start != 0.0] / (wanted - start)[start != 0.0]
    assert share == pytest.approx(np.full_like(share, share[0]))
    assert np.log2(share[0]) == pytest.approx(round(np.log2(share[0])))
    assert not np.isfinite(
        measurement.try_readings(series, start + 2.0 * (reached - start))
    ).all()
    near = start * (1.0 + 1e-6)
    assert fit.closing(start, near) == pytest.approx(near, abs=0.0)


def test_a_pose_that_fails_in_a_step_is_no_fault_of_the_data(monkeypatch):
    measurement = Measurement(linear_delta.machine, [mount(position, "tracker")])
    home = linear_delta.machine.home_command
    series = [measurement.series("tracker", home + 0.01 * np.eye(3)[[0, 1, 2, 0]])]
    y = measurement.readings(series, measurement.nominal)

    def fails(*_: object) -> None:
        raise AssemblyError("check joint values and their unit", np.arange(4))

    monkeypatch.setattr(identification, "last_stage", fails)
    with pytest.raises(IdentificationError, match="has a pose at the start") as error:
        identify(measurement, series, y)
    assert "joint values" not in str(error.value)


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
