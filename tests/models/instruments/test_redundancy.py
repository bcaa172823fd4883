"""Machines with several spare joints as their own instrument, against a simulator of
their own (tests/oracles/planar_cables.py) and finite differences.
"""

import numpy as np
import pytest
from oracles import planar_cables
from scipy import optimize
from shipped_models import cables_planar, cables_spatial

from oed.estimation import Estimate, identify
from oed.instrument import mount
from oed.measurement import Measurement
from oed.model import Machine
from pkm_models.instruments import redundancy

DRUM = 0.3e-3  #: m, of one drum


def _machine() -> Machine:
    geometry = {"anchor": planar_cables.ANCHORS, "tolerance": planar_cables.PLACE}
    return cables_planar.build(geometry)


def _calibrated(
    measurement: Measurement, noise: np.ndarray, rng: np.random.Generator
) -> tuple[Estimate, np.ndarray]:
    """A drawn robot's estimate from its cable lengths alone, and its true parameters."""
    robot = planar_cables.drawn(rng)
    q = planar_cables.recorded(robot, rng.uniform(-0.5, 0.5, (40, 2)), noise, rng)
    series = measurement.series_from_joints("cables", q)
    y = np.zeros(2 * len(q))
    truth = robot.by_name()
    return identify(measurement, [series], y), np.array(
        [truth[n] for n in measurement.names]
    )


def _measurement() -> Measurement:
    machine = _machine()
    instrument = redundancy.instrument.for_machine(machine)
    sigma = [DRUM / 2.0] * 2  # four equations
    return Measurement(machine, [mount(instrument, "cables", sigma=sigma)])


def test_cable_lengths_alone_calibrate_a_robot_with_two_spare_joints(rng):
    estimate, truth = _calibrated(_measurement(), np.full(4, DRUM), rng)
    before = np.abs(estimate.residuals_before).max()
    assert np.abs(estimate.residuals).max() < 5.0 * DRUM < before
    assert estimate.sd.min() < 0.5 * planar_cables.PLACE
    pulls = (estimate.theta - truth) / estimate.sd
    assert np.abs(pulls).max() < 4.5


@pytest.mark.parametrize("module", [cables_planar, cables_spatial])
def test_the_misfits_are_the_residuals_that_no_pose_removes(module, rng):
    """Their norm is that of the constraints' residual by SciPy's least squares."""
    machine = module.machine  # type: ignore[attr-defined]
    instrument = redundancy.instrument.for_machine(machine)
    assert [c.name for c in instrument.channels] == ["gap1", "gap2"]
    m = Measurement(machine, [mount(instrument, "cables")])
    low = [
        0.5 * (c.lower + c.upper) - 0.3 * (c.upper - c.lower) for c in machine.command
    ]
    high = [
        0.5 * (c.lower + c.upper) + 0.3 * (c.upper - c.lower) for c in machine.command
    ]
    command = rng.uniform(low, high, (5, len(low)))
    x, q = m.kinematics.inverse(command)
    q += 1e-3 * rng.standard_normal(q.shape)
    series = m.series_from_joints("cables", q)
    gaps = m.readings([series], m.nominal).reshape(5, 2)
    names = [c.name for c in machine.pose]
    p = {k.name: k.nominal for k in machine.parameters}
    for start, joints, gap in zip(x, q, gaps, strict=True):
        by_name = {f"q{i + 1}": v for i, v in enumerate(joints)}

        def residual(
            at: np.ndarray, by_name: dict[str, float] = by_name
        ) -> list[float]:
            pose = dict(zip(names, at, strict=True))
            return [float(v) for v in machine.closure(pose, by_name, p)]

        least = optimize.least_squares(residual, start, xtol=1e-15, ftol=1e-15)
        expected = np.linalg.norm(least.fun) / np.sqrt(len(joints))
        assert np.linalg.norm(gap) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("module", [cables_planar, cables_spatial])
def test_a_joint_that_errs_changes_the_misfits_as_its_slope_says(module, rng):
    """By central differences of the exact readings; effects of joints rest on it."""
    machine = module.machine  # type: ignore[attr-defined]
    instrument = redundancy.instrument.for_machine(machine)
    m = Measurement(machine, [mount(instrument, "cables")])
    q = m.kinematics.inverse(machine.home_command[None])[1]
    series = m.series_from_joints("cables", q + 1e-3 * rng.standard_normal(q.shape))
    (slopes,) = m.of(series).response(series, m.nominal).joints
    step, still = 1e-6, np.zeros((1, len(m.nominal)))
    for k in range(q.shape[1]):
        change = np.zeros_like(q)
        change[0, k] = step
        ahead, behind = (
            m.of(series).perturbed(
                series, m.nominal, sign * change, still, still[:, :0]
            )
            for sign in (1.0, -1.0)
        )
        numeric = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(slopes[0, :, k], numeric, rtol=1e-6, atol=1e-8)
        assert np.abs(numeric).max() > 1e-3


def test_slopes_of_the_misfits_are_those_of_the_exact_readings(rng):
    m = _measurement()
    series = m.series("cables", rng.uniform(-0.4, 0.4, (10, 2)))
    theta = m.nominal + m.tolerance * rng.standard_normal(len(m.names))
    slopes, step = m.jacobian([series], theta), 1e-6
    for k in range(len(theta)):
        move = step * np.eye(len(theta))[k]
        ends = [m.readings([series], theta + s * move) for s in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(slopes[:, k] - difference).max() < 1e-8


def test_noise_per_leg_is_projected_onto_the_misfits(rng):
    machine = _machine()
    noise = {f"noise_q{i}": v for i, v in enumerate([1e-3, 1e-4, 2e-4, 3e-4], start=1)}
    per_leg = redundancy.per_leg.for_machine(machine)
    m = Measurement(machine, [mount(per_leg, "cables", **noise)])  # type: ignore[arg-type]
    series = m.series("cables", np.array([[0.1, -0.2]]))
    x, _ = m.kinematics.inverse(np.array([[0.1, -0.2]]))
    away = x[0] - planar_cables.ANCHORS
    unit = away / np.linalg.norm(away, axis=1)[:, None]
    across = np.eye(4) - unit @ np.linalg.inv(unit.T @ unit) @ unit.T
    expected = across @ np.diag(np.square(list(noise.values()))) @ across / 4.0
    covariance = m.of(series).reading_covariances(series)[0]
    values = np.linalg.eigvalsh(expected)[-2:]
    assert np.linalg.eigvalsh(covariance) == pytest.approx(values, rel=1e-9)
