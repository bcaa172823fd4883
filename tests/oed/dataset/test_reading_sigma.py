"""A standard deviation for each reading: read, used by every step, written back."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from shipped_models import laser_ball_bar, linear_delta, pose_tracker

from oed import Measurement, dataset, mount
from oed.dataset import ReadingsError
from oed.estimation import identify
from oed.gap import prepare
from oed.measurement import reading_structure
from oed.posterior import draw_approximation

laser = laser_ball_bar.position
position = pose_tracker.position
machine = linear_delta.machine

SIGMA_UM = np.array([5.0, 5.0, 20.0])
PLACES = [(x, y, z) for x in (-60, 0, 60) for y in (-60, 0, 60) for z in (40, 120)]


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    """A delta under a tracker whose frame is known."""
    fixed = {n.name: 0.0 for n in position.nuisances}
    sigma = list(1e-6 * SIGMA_UM)
    setup = mount(position, "tracker", sigma=sigma, tolerances=fixed)
    return Measurement(machine, [setup])


@pytest.fixture(scope="module")
def text(measurement: Measurement) -> str:
    """Readings with errors of their own size; a third of the rows states none in z."""
    rng = np.random.default_rng(2)
    own = SIGMA_UM * rng.uniform(0.2, 8.0, (len(PLACES), 3))
    own[::3, 2] = SIGMA_UM[2]
    truth = measurement.nominal + 1e-4 * rng.normal(size=len(measurement.nominal))
    series = measurement.series("tracker", 1e-3 * np.array(PLACES, dtype=float))
    read = measurement.readings([series], truth).reshape(-1, 3)
    read += 1e-6 * own * rng.normal(size=own.shape)
    head = "setup,run,order,x_mm,y_mm,z_mm,read_x_mm,read_y_mm,read_z_mm"
    lines = [head + ",sigma_read_x_um,sigma_read_y_um,sigma_read_z_mm"]
    for k, (place, y, sd) in enumerate(zip(PLACES, read, own, strict=True)):
        z = "" if k % 3 == 0 else repr(float(1e-3 * sd[2]))
        cells = [*place, *(1e3 * y), sd[0], sd[1]]
        lines.append(
            f"tracker,1,{k + 1}," + ",".join(map(repr, map(float, cells))) + f",{z}"
        )
    return "\n".join(lines)


def stated(text: str) -> np.ndarray:
    """Standard deviations (N,), SI, out of the text alone."""
    rows = [line.split(",")[-3:] for line in text.splitlines()[1:]]
    factors = (1e-6, 1e-6, 1e-3)
    default = 1e-6 * SIGMA_UM
    values = [
        [float(c) * f if c else d for c, f, d in zip(r, factors, default, strict=True)]
        for r in rows
    ]
    return np.ravel(values)


def loaded(text: str, measurement: Measurement, folder: Path) -> dataset.Dataset:
    path = folder / "a.readings.csv"
    path.write_text(text)
    return dataset.load(path, measurement)


def test_the_fit_is_weighted_least_squares(measurement, text, tmp_path):
    data = loaded(text, measurement, tmp_path)
    sd = stated(text)
    np.testing.assert_allclose(measurement.sigma(data.series), sd, rtol=1e-12)
    estimate = identify(measurement, data.series, data.y, estimate_noise=False)
    free = measurement.free
    tolerance = measurement.tolerance[free]

    def residual(z: np.ndarray) -> np.ndarray:
        theta = measurement.nominal
        theta[free] += tolerance * z
        misfit = (measurement.readings(data.series, theta) - data.y) / sd
        return np.concatenate([misfit, z])

    fit = least_squares(residual, np.zeros(free.sum()), xtol=1e-14, ftol=1e-14)
    change = (estimate.theta - measurement.nominal)[free]
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * np.outer(tolerance, tolerance)
    spread = np.sqrt(np.diag(covariance))
    assert np.abs(change - tolerance * fit.x).max() < 1e-3 * spread.max()
    own = estimate.covariance[np.ix_(free, free)]
    np.testing.assert_allclose(np.diag(own), np.diag(covariance), rtol=1e-3)


def test_every_step_takes_the_noise_of_the_readings(measurement, text, tmp_path):
    data = loaded(text, measurement, tmp_path)
    sd = stated(text)
    structure = reading_structure(measurement, data.series, measurement.nominal)
    np.testing.assert_allclose(structure.unit, sd, rtol=1e-12)
    assert np.sqrt(structure.variances.sum(axis=1)[2]) == pytest.approx(
        np.sqrt(np.mean(sd[2::3] ** 2))
    )
    diagnosed = prepare(measurement, data.series, data.y, data.covariates)
    np.testing.assert_allclose(diagnosed.sigma, sd, rtol=1e-12)
    estimate = identify(measurement, data.series, data.y)
    draws = draw_approximation(
        measurement, data.series, data.y, estimate, np.random.default_rng(1)
    )
    spread = np.sqrt(np.diag(estimate.covariance))[measurement.free]
    np.testing.assert_allclose(
        draws.theta.std(axis=0)[measurement.free], spread, rtol=0.35
    )
    # rows taken in another order keep theirs
    (series,) = data.series
    order = np.array([5, 1, 7])
    taken = measurement.sigma([series.take(order)]).reshape(-1, 3)
    np.testing.assert_allclose(taken, sd.reshape(-1, 3)[order], rtol=1e-12)


def test_a_file_written_back_has_the_same_noise(measurement, text, tmp_path):
    data = loaded(text, measurement, tmp_path)
    again = loaded(dataset.to_csv(data), measurement, tmp_path)
    np.testing.assert_allclose(
        measurement.sigma(again.series), measurement.sigma(data.series), rtol=1e-12
    )
    assert "sigma_read_x_mm" in dataset.to_csv(data).splitlines()[0]


def test_channels_of_common_sources_scale_with_their_reading():
    """A laser ball bar's error inside grows with the stated one of each channel."""
    setup = mount(laser, "bar", at_x=0.0, at_y=0.0, at_z=-0.4)
    bar = Measurement(machine, [setup])
    series = bar.series("bar", 1e-3 * np.array(PLACES[:4], dtype=float))
    factor = np.array([1.0, 2.0, 3.0, 0.5])[:, None] * np.ones(len(setup.sigma))
    own = dataclasses.replace(series, sigma=factor * np.array(setup.sigma))
    before, after = bar.sigma([series]), bar.sigma([own])
    np.testing.assert_allclose(after / before, factor.ravel(), rtol=1e-12)


@pytest.mark.parametrize(("cell", "words"), [
    ("0", "no reading has such"), ("-3", "no reading has such"), ("x", "finite"),
])  # fmt: skip
def test_what_is_no_standard_deviation_is_refused(cell, words, measurement, tmp_path):
    lines = [
        "setup,run,order,x_mm,y_mm,z_mm,read_x_mm,read_y_mm,read_z_mm,sigma_read_x_um",
        f"tracker,1,1,0,0,40,0,0,40,{cell}",
    ]
    with pytest.raises(ReadingsError, match=words) as caught:
        loaded("\n".join(lines), measurement, tmp_path)
    assert "sigma_read_x_um" in str(caught.value)


def test_the_noise_of_a_channel_that_nobody_reads_is_refused(measurement, tmp_path):
    lines = [
        "setup,run,order,x_mm,y_mm,z_mm,read_x_mm,read_y_mm,read_z_mm,sigma_height_um",
        "tracker,1,1,0,0,40,0,0,40,5",
    ]
    with pytest.raises(ReadingsError, match="unknown column"):
        loaded("\n".join(lines), measurement, tmp_path)
