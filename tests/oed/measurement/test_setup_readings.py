"""One set-up's readings: changes at single poses, and slopes, against the oracle."""

import numpy as np
import pytest
from oracles import a3_geometry as a3

from kernel import a3_plans
from oed.measurement.setup_readings import SetupReadings

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
