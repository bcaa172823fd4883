"""Observations, their noise and their runs against differences and matrices by hand."""

import dataclasses

import numpy as np
import pytest
from shipped_models import a3_head, ball_bar, laser_ball_bar, prs_spindle

from oed.instrument import Setup, mount
from oed.measurement import Measurement, Series, reading_structure
from oed.measurement.measurement import _solve_coordinate
from oed.measurement.setup_readings import ObservationModel, stated_noise
from oed.model import Coordinate

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
    solved, found = _solve_coordinate(square, 1.0, command, 1, axis)
    assert found.tolist() == [True, True, False]
    assert solved[:2] == pytest.approx(np.array([[0.6, 0.8], [0.0, 1.0]]))
