"""Effects of no known form: what they move, and with which sign."""

import numpy as np
import pytest
from effects_sample import session

from oed.effect_model import Column, State
from oed.effects.columns import (
    TIME_TERMS,
    UNIT_SIZE,
    WORKSPACE_TERMS,
    course_terms,
    place_terms,
    unknown_effects,
)

EFFECTS = {effect.name: effect for effect in unknown_effects()}


@pytest.fixture(scope="module", params=["planar_2dof", "linear_delta", "hexaglide"])
def state(request: pytest.FixtureRequest) -> State:
    return session(request.param).states[0]


def columns(name: str, state: State) -> dict[str, Column]:
    made = list(EFFECTS[name].columns(state))
    assert len({c.name for c in made}) == len(made)
    return {c.name: c for c in made}


def test_an_error_of_the_tool_displaces_it_along_one_axis(state):
    terms = place_terms(state)
    for k in (0, 3):
        moved = np.zeros((len(state), 3))
        term = columns("unknown tool place", state)[f"z {k + 1}"]
        for joint, change in term.joints.items():
            moved += state.twist[:, :3, joint] * change[:, None]
        assert moved[:, 2] == pytest.approx(terms[:, k], abs=1e-6)
        assert np.abs(moved[:, :2]).max() < 1e-6


def test_an_error_with_the_direction_changes_its_sign(state):
    there, back = state.direction > 0, state.direction < 0
    plain = columns("unknown tool place", state)["z 1"]
    reversing = columns("unknown tool direction", state)["z 1"]
    for joint, change in reversing.joints.items():
        assert change[there] == pytest.approx(plain.joints[joint][there])
        assert change[back] == pytest.approx(-plain.joints[joint][back])


def test_joints_err_one_by_one_and_readings_by_channel(state):
    of_joints = columns("unknown joints time", state)
    assert {c.label for c in of_joints.values()} == {
        f"leg {i + 1}" for i in state.limbs
    }
    assert all(len(c.joints) == 1 for c in of_joints.values())
    of_leg = columns("unknown joints place", state)["leg 1 1"].joints
    assert of_leg[0] == pytest.approx(place_terms(state)[:, 0])
    of_readings = columns("unknown readings place", state)
    assert {channel for c in of_readings.values() for channel in c.reading} == set(
        state.channels
    )
    assert all(c.scale == UNIT_SIZE for c in of_readings.values())


def test_terms_are_independent_and_fall_with_their_order(state):
    places, times = place_terms(state), course_terms(state)
    assert places.shape == (len(state), WORKSPACE_TERMS)
    assert times.shape == (len(state), TIME_TERMS)
    assert np.abs(places).max(axis=0)[0] > np.abs(places).max(axis=0)[-1]
    assert np.linalg.matrix_rank(times) == TIME_TERMS
