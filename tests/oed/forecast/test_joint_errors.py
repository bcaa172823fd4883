"""Error rows of joints against differences of the oracles' closed forms."""

import numpy as np
import pytest
from oracles import a3_geometry, planar_geometry
from shipped_models import a3_head, planar_2dof

from oed.forecast import JointErrors
from oed.mechanism import Kinematics

PLANAR, HEAD = Kinematics(planar_2dof.machine), Kinematics(a3_head.machine)
COMMAND = np.array([[0.2, 0.1], [-1.1, 0.9], [1.3, 1.2]])
NOTHING = np.zeros((7, 0))


def longer(command: np.ndarray, k: int) -> np.ndarray:
    """Motion of the platform per excess length of strut k, by differences."""
    joints, step = planar_geometry.inverse(command), 1e-6
    change = step * (np.arange(7) == 3 + k)
    ahead = planar_geometry.forward(joints, planar_geometry.NOMINAL + change)
    behind = planar_geometry.forward(joints, planar_geometry.NOMINAL - change)
    return (ahead - behind) / (2.0 * step)


def test_a_longer_strut_moves_the_platform_here_and_less_at_home():
    rows = JointErrors(PLANAR, COMMAND, "home", NOTHING).rows(COMMAND)
    for k in (0, 1):
        assert rows.local[:, :, k] == pytest.approx(longer(COMMAND, k), abs=1e-7)
        at_home = longer(np.zeros((3, 2)), k)
        assert rows.at_home[:, :, k] == pytest.approx(-at_home, abs=1e-7)
    absolute = JointErrors(PLANAR, COMMAND, "absolute", NOTHING).rows(COMMAND)
    assert absolute.local == pytest.approx(rows.local)
    assert not absolute.at_home.any()


def test_parameters_are_known_by_their_standard_deviations():
    spread = np.zeros((7, 1))
    spread[0] = 2e-6  # the distance of the columns
    rows = JointErrors(PLANAR, COMMAND, "home", spread).rows(COMMAND)
    slopes = planar_geometry.rows(COMMAND) - planar_geometry.rows(np.zeros(2))
    assert rows.by_parameter[:, :, 0] == pytest.approx(
        2e-6 * slopes[:, :, 0], abs=1e-12
    )


def test_places_go_round_and_fill_minus_one_to_one(rng):
    low, high = [1.066, 0.0, 0.1], [1.266, 2.0 * np.pi, 0.6]
    model = JointErrors(
        HEAD, rng.uniform(low, high, (50, 3)), "home", np.zeros((24, 0))
    )
    places = model.positions(model.command)
    assert places.min(axis=0) == pytest.approx([-1.0] * 3)
    assert places.max(axis=0) == pytest.approx([1.0] * 3)
    ends = model.positions(np.array([[1.1, 0.0, 0.3], [1.1, 2.0 * np.pi, 0.3]]))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
    # distances among places are those of the oracle's joints, each axis over its span
    joints = a3_geometry.inverse_nominal(*model.command.T)
    span = np.linalg.svd(joints - joints.mean(axis=0), full_matrices=False)[2]
    along = joints @ span.T
    scaled = 2.0 * along / np.ptp(along, axis=0)
    differences = np.abs(places - places[0])
    assert differences == pytest.approx(np.abs(scaled - scaled[0]), abs=1e-9)


def test_psi_of_an_upright_tool_has_no_meaning():
    model = JointErrors(HEAD, np.array([[1.1, 0.0, 0.3]]), "home", np.zeros((24, 0)))
    command = np.array([[1.1, 0.0, 0.3], [1.1, 0.0, 0.0]])
    meaningful = model.meaningful(command)
    assert meaningful.tolist() == [[True] * 3, [True, False, True]]
