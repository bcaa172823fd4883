"""Zeroed at home has one meaning, by closed-form A3 heads and SciPy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shipped_models import a3_head, ball_bar

from oed import Measurement, mount
from oed.accuracy import components_against, driven_errors
from oed.mechanism import pose_error

instrument = ball_bar.instrument
machine = a3_head.machine

COMMAND = np.array(
    [[1.10, 0.0, 0.2], [1.15, 2.1, 0.4], [1.20, 4.2, 0.5], [1.13, 5.0, 0.1]]
)


@pytest.fixture(scope="module")
def kinematics():
    cup = mount(instrument, "cup", length=0.3, teach=machine.home_command)
    return Measurement(machine, [cup]).kinematics


@pytest.fixture(scope="module")
def drawn() -> np.ndarray:
    """Parameters (6, np), SI, of machines that lose milliradians at home."""
    rng = np.random.default_rng(3)
    free = ~np.isin([p.name for p in machine.parameters], machine.frame)
    tolerance = np.array([p.tolerance for p in machine.parameters])
    return machine.nominal + 0.3 * tolerance * free * rng.standard_normal(
        (6, len(free))
    )


def composed(kinematics, parameters: np.ndarray) -> np.ndarray:
    """Errors (n, k) by rotations: R R_home^T against the commanded turn from home."""
    poses = np.vstack([COMMAND, machine.home_command])
    x, q = kinematics.inverse(poses)
    rotation, point, _ = kinematics.frames(x, np.zeros(3))
    reached = kinematics.forward(q, parameters, x)
    true_rotation, true_point, _ = kinematics.frames(reached, np.zeros(3))
    wanted, true = (Rotation.from_matrix(r) for r in (rotation, true_rotation))
    turned = (true[:-1] * true[-1].inv()) * (wanted[:-1] * wanted[-1].inv()).inv()
    shift = true_point - point
    twist = np.hstack([shift[:-1] - shift[-1], turned.as_rotvec()])
    return kinematics.error_components(COMMAND, twist)


def test_exact_errors_are_relative_rotations(kinematics, drawn):
    poses = np.vstack([COMMAND, machine.home_command])
    nominal = machine.nominal
    expected = np.array([composed(kinematics, p) for p in drawn])
    _, q = kinematics.inverse(poses)
    twists = np.array([pose_error(kinematics, poses, q, p) for p in drawn])
    against = components_against(kinematics, COMMAND, twists, "home")
    sent = [driven_errors(kinematics, COMMAND, p, "home") for p in drawn]
    alone = driven_errors(kinematics, COMMAND, drawn, "home", believed=nominal)
    held = np.tile(nominal, (len(drawn), 1))
    virtual = driven_errors(kinematics, COMMAND, drawn, "home", believed=held)
    for found in (against, sent, alone, virtual):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-10)
    # vectors subtracted would be another error by half of it
    subtracted = twists[:, :-1] - twists[:, -1:]
    wrong = kinematics.error_components(
        np.tile(COMMAND, (len(drawn), 1)), subtracted.reshape(-1, 6)
    ).reshape(expected.shape)
    psi = [c.name for c in machine.components].index("psi")
    assert (
        np.abs(wrong - expected)[..., psi].max()
        > 0.5 * np.abs(expected)[..., psi].max()
    )
