"""Observations, their noise, runs, courses and set-ups against differences and matrices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles import a3_geometry as a3
from shipped_models import a3_head, ball_bar, camera, delta, laser_ball_bar, prs_spindle

from kernel import a3_plans, bar_circles
from kernel.laws import dense_covariance
from oed.accuracy.budget import COURSE, errors_of_readings
from oed.instrument import Setup, mount
from oed.measurement import Measurement, Series, reading_structure
from oed.measurement.measurement import _solve_coordinate
from oed.measurement.noise_structure import course_terms
from oed.measurement.setup_readings import ObservationModel, SetupReadings, stated_noise
from oed.model import Coordinate
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePrior

GIMBAL = {"at_x": 0.0, "at_y": -0.7, "at_z": 0.2}
BAR = mount(ball_bar.instrument, "bar", teach=(1.2, 0.0, 0.0), sigma=[0.5e-6])


@pytest.fixture(scope="module")
def circle() -> tuple[Measurement, Series]:
    m = Measurement(a3_head.machine, [BAR])
    psi = np.linspace(-3.0, 3.0, 8)
    command = np.column_stack([np.full(8, 1.15), psi, np.full(8, 0.3)])
    return m, m.series("bar", command, run=["a"] * 5 + ["b"] * 3)


def test_slopes_of_a_reading_are_its_differences(circle):
    _, series = circle
    model = ObservationModel(a3_head.machine, BAR)
    inputs = [*(series.start[k] for k in series.pose_indices()), np.zeros(3)]
    by_pose, by_setup, by_parameter = model.jacobians(inputs)
    assert by_parameter is None
    assert model.joint_jacobians(inputs) is None
    for place, slopes in enumerate([*by_pose, by_setup]):
        step = np.zeros(inputs[place].shape[-1])
        step[1] = 1e-6
        ahead, back = (
            model.read(
                [v + s * step if k == place else v for k, v in enumerate(inputs)]
            )
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes[..., 1], (ahead - back) / 2e-6, atol=1e-7)


def stating(**numbers: float) -> Setup:
    return dataclasses.replace(
        BAR, statement=dataclasses.replace(BAR.statement, **numbers)
    )


def sharing(setup: Setup, channel: int, shared: float) -> Setup:
    """The set-up with a channel whose errors a run shares."""
    channels = [
        dataclasses.replace(c, shared=shared if k == channel else 0.0)
        for k, c in enumerate(setup.instrument.channels)
    ]
    instrument = dataclasses.replace(setup.instrument, channels=tuple(channels))
    return dataclasses.replace(setup, instrument=instrument)


def test_noise_carried_along_falls_with_the_distance(circle):
    _, series = circle
    setup = sharing(stating(correlated=0.4, reach=2.0), 0, 0.6)
    m = Measurement(a3_head.machine, [setup])
    noise = stated_noise([(m.of(series), series)])
    apart = np.abs(np.subtract.outer(np.arange(8), np.arange(8)))
    along = 0.4 * np.exp(-apart / 2.0) + 0.6 * np.eye(8)
    covariance = 0.25e-12 * along + 0.09e-12
    covariance[:5, 5:] = covariance[5:, :5] = 0.0
    white = noise.whiten(np.linalg.cholesky(covariance))
    np.testing.assert_allclose(white @ white.T, np.eye(8), atol=1e-9)
    assert noise.sigma == pytest.approx(np.sqrt(np.diag(covariance)))


def test_channels_with_common_sources_have_a_covariance():
    setup = mount(laser_ball_bar.instrument, "laser", **GIMBAL)
    m = Measurement(prs_spindle.machine, [setup])
    series = m.series("laser", np.array([[0.6, 0.1, 0.0], [0.65, 0.0, 0.1]]))
    covariances = m.of(series).reading_covariances(series)
    slopes = m.of(series).source_gradients(series)
    np.testing.assert_allclose(covariances, slopes @ np.swapaxes(slopes, 1, 2))
    assert np.abs(covariances[0] - np.diag(np.diag(covariances[0]))).max() > 0.0


def test_a_level_is_shared_by_its_channel_alone():
    setup = sharing(mount(laser_ball_bar.instrument, "laser", **GIMBAL), 1, 0.5)
    m = Measurement(prs_spindle.machine, [setup])
    series = m.series("laser", np.array([[0.6, 0.1, 0.0], [0.65, 0.0, 0.1]]))
    errors = m.of(series).run_errors(series)
    channels = len(setup.instrument.channels)
    assert errors.shape == (2, channels, 1)
    wanted = np.zeros(channels)
    wanted[1] = 0.5 * setup.sigma[1]
    np.testing.assert_allclose(errors[0, :, 0], wanted)


def test_runs_are_chains_of_readings(circle):
    m, series = circle
    structure = reading_structure(m, [series], m.nominal)
    assert structure.unit == pytest.approx(np.full(8, 0.5e-6))
    assert structure.run[structure.chain].tolist() == [0] * 5 + [1] * 3
    assert structure.position.tolist() == [*range(5), *range(3)]


def test_a_machine_near_nominal_stays_in_its_mode(circle):
    m, series = circle
    assert m.mode_jumps([series], m.nominal) == (0, len(series.command))


def test_a_coordinate_is_solved_where_there_is_a_solution():
    """z with x^2 + z^2 = 1 within 0 to 1; there is none from x = 1 on."""
    command = np.array([[0.6, 9.0], [0.0, 9.0], [1.2, 9.0]])
    axis, square = Coordinate("z", "m", 0, 1.5), lambda c: np.square(c).sum(axis=1)
    solved, found = _solve_coordinate(square, 1.0, command, 1, axis, 0.0)
    assert found.tolist() == [True, True, False]
    assert solved[:2] == pytest.approx(np.array([[0.6, 0.8], [0.0, 1.0]]))
    # over a range that the circle crosses twice, beyond home
    both = Coordinate("z", "m", -1.5, 1.5)
    solved, found = _solve_coordinate(square, 1.0, command, 1, both, 0.0)
    assert found.tolist() == [True, True, False]
    assert solved[:2] == pytest.approx(np.array([[0.6, 0.8], [0.0, 1.0]]))


def test_a_machine_through_its_singular_pose_is_counted():
    """A delta whose tool would be above the carriages: the mirrored solution."""
    m = Measurement(delta.machine, [mount(camera.known_frame, "camera")])
    series = m.series("camera", np.array([[0.0, 0.0, 0.1], [0.02, 0.01, 0.2]]))
    assert m.mode_jumps([series], m.nominal) == (0, 2)
    carriages = delta.machine.nominal[9] + np.sqrt(0.345**2 - 0.16175**2) - series.q
    above = series.start.copy()
    above[:, 2] = 2.0 * carriages.mean(axis=1) - above[:, 2]
    mirrored = m.kinematics.forward(series.q, m.nominal, above)
    side = m.kinematics.assembly_side(mirrored, series.q, m.nominal)
    assert (
        side * m.kinematics.assembly_side(series.start, series.q, m.nominal)
    ).tolist() == [-1.0, -1.0]


def test_the_variance_grows_with_the_session():
    """A Wiener process has variance t; four terms leave a little of it."""
    progress = np.linspace(0.0, 1.0, 41)
    terms = course_terms(np.zeros(41, dtype=np.intp), progress)
    variance = (terms**2).sum(axis=1)
    assert np.all(variance <= progress + 1e-12)
    assert np.abs(variance - progress).max() < 0.06
    covariance = terms @ terms.T
    wiener = np.minimum(progress[:, None], progress)
    assert np.abs(covariance - wiener).max() < 0.06


def test_a_group_has_a_term_for_each_five_readings():
    group = np.repeat([0, 1, 2], [20, 14, 4]).astype(np.intp)
    terms = course_terms(group, np.linspace(0.0, 1.0, len(group)))
    of_group = [np.count_nonzero(terms[group == k].any(axis=0)) for k in range(3)]
    assert of_group == [4, 2, 0]


@pytest.fixture(scope="module")
def structure() -> ReadingStructure:
    """Three runs of a ball bar."""
    return bar_circles.circles(8)


@pytest.fixture(scope="module")
def laws(structure: ReadingStructure) -> Laws:
    prior = NoisePrior.of(structure)
    draws = np.random.default_rng(2).standard_normal((3, prior.dimensions))
    return prior.laws(draws)


def test_few_degrees_of_freedom_have_none(structure):
    terms = structure.course.shape[1]
    assert NoisePrior.COURSE in NoisePrior.of(structure, 10.0 + terms).names
    assert NoisePrior.COURSE not in NoisePrior.of(structure, 9.9 + terms).names


def test_without_its_error_the_rest_is_that_of_a_law_without_one(structure, laws):
    law = laws.take([0])
    still = dataclasses.replace(law, course=np.zeros(1))
    y = np.random.default_rng(4).standard_normal((len(structure), 3))
    errors = errors_of_readings(structure, law, ["bar"] * len(structure))
    assert COURSE in errors.names
    white = errors.whiten(y, {COURSE: 0.0})
    exact = y.T @ np.linalg.solve(dense_covariance(structure, still), y)
    assert white.T @ white == pytest.approx(exact, rel=1e-9)
    assert COURSE not in errors_of_readings(structure, still, ["bar"] * 24).names


M = a3_plans.measurement()
(NAME,) = M.setups
SERIES = M.series(NAME, a3_plans.circles(M, 3).command[:4]).separate_poses()
COUNT = len(M.kinematics.machine.parameters)
READ = SetupReadings(M.kinematics, M.setups[NAME], slice(COUNT, len(M.nominal)))


def oracle(joints: np.ndarray, p: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Bar lengths (n,) with joints and parameters of each pose, cups shifted (n, 3)."""
    tips = np.array(
        [a3.forward(e, q[None]).tip[0] for q, e in zip(joints, p, strict=True)]
    )
    tool, cup = tips[SERIES.index[:, 0]], tips[SERIES.index[:, 1]]
    return np.linalg.norm(tool - cup - shift, axis=1)


def test_each_pose_may_have_changes_of_its_own(rng):
    theta = M.nominal + M.tolerance * rng.standard_normal(len(M.nominal))
    poses = len(SERIES.q)
    joints = 1e-5 * rng.standard_normal((poses, 3))
    parameters = 1e-5 * rng.standard_normal((poses, COUNT))
    nuisances = 1e-5 * rng.standard_normal((len(SERIES), len(theta) - COUNT))
    found = READ.perturbed(SERIES, theta, joints, parameters, nuisances)
    shift = theta[COUNT:] + nuisances
    exact = oracle(SERIES.q + joints, theta[:COUNT] + parameters, shift)
    assert found == pytest.approx(exact, abs=1e-11)


def test_slopes_are_differences_of_exact_readings(rng):
    theta = M.nominal + M.tolerance * rng.standard_normal(len(M.nominal))
    poses, step = len(SERIES.q), 1e-6
    still, same = np.zeros((poses, COUNT)), np.zeros((len(SERIES), 3))
    response = READ.response(SERIES, theta)
    for side in (0, 1):
        for joint in range(3):
            change = np.zeros((poses, 3))
            change[SERIES.index[:, side], joint] = step
            ahead = READ.perturbed(SERIES, theta, change, still, same)
            behind = READ.perturbed(SERIES, theta, -change, still, same)
            exact = (ahead - behind) / (2.0 * step)
            slopes = response.joints[side][:, 0, joint]
            if side == 1:  # the taught pose may be common to readings
                assert len(set(SERIES.index[:, 1])) in (1, len(SERIES))
            assert slopes == pytest.approx(exact, abs=1e-8)
    jacobian = READ.jacobian(SERIES, theta[None])[0]
    for k, change in enumerate(step * np.eye(len(theta))):
        ahead = READ.perturbed(SERIES, theta + change, 0.0 * SERIES.q, still, same)
        behind = READ.perturbed(SERIES, theta - change, 0.0 * SERIES.q, still, same)
        exact = (ahead - behind) / (2.0 * step)
        assert jacobian[:, k] == pytest.approx(exact, abs=1e-8)


def test_nominal_slopes_over_the_cup_are_unit_vectors():
    """A cup that moves by d shortens the bar by its part along the bar."""
    zero = np.zeros((len(SERIES.q), COUNT))
    tips = np.array(
        [a3.forward(e, q[None]).tip[0] for q, e in zip(SERIES.q, zero, strict=True)]
    )
    bar = tips[SERIES.index[:, 0]] - tips[SERIES.index[:, 1]]
    along = bar / np.linalg.norm(bar, axis=1)[:, None]
    assert READ.nominal_jacobian(SERIES)[:, 0] == pytest.approx(-along, abs=1e-9)
