"""Effects of gears, cables and targets, each against its own geometry."""

import dataclasses

import numpy as np
import pytest
from effects_sample import columns, effect_of, session
from scipy import optimize
from shipped_models import five_bar, hexapod_rus

ROTARY = (five_bar.machine, hexapod_rus.machine)


@pytest.mark.parametrize("machine", ROTARY)
def test_cranks_have_gears_and_neither_screws_nor_carriages(machine):
    assert effect_of("gear_eccentricity").unfit(machine) is None
    for name in ("screw_cyclic", "pitch_accumulation", "guideway", "drum_runout"):
        assert effect_of(name).unfit(machine) is not None
    direct = dataclasses.replace(machine, drive="linear_motor")
    assert effect_of("gear_eccentricity").unfit(direct) is not None


def test_an_eccentric_wheel_repeats_with_its_turns():
    state = session("cable_robot").states[1]
    turns = np.linspace(0.0, 2.0 * np.pi, len(state))
    at = dataclasses.replace(
        state, joints=np.repeat(turns[:, None], len(state.limbs), axis=1)
    )
    column = columns("gear_eccentricity", at, ratio=5.0)["leg 3 sin 1"]
    assert column.joints[2] == pytest.approx(np.sin(5.0 * turns))


def _paid_out(guide: np.ndarray, platform: np.ndarray, radius: float) -> float:
    """Length of a cable from the foot of its pulley to the platform, by its tangent.

    It comes up a post at `guide`; the pulley's middle is `radius` towards the platform.
    """
    level = platform[:2] - guide[:2]
    out = np.hypot(*level)
    x, z = out - radius, platform[2] - guide[2]

    def miss(arc: float) -> float:
        """Offset of the platform from the tangent that leaves after an arc."""
        start = radius * np.array([-np.cos(arc), np.sin(arc)])
        along = np.array([np.sin(arc), np.cos(arc)])
        way = np.array([x, z]) - start
        return float(way[0] * along[1] - way[1] * along[0])

    arc = optimize.brentq(miss, 1e-3, np.pi - 1e-3)
    free = np.sqrt(x**2 + z**2 - radius**2)
    return radius * arc + free


def test_a_pulley_winds_what_its_tangent_does():
    state = session("cable_robot").states[1]
    column = columns("pulley_radius", state)["pulleys"]
    radius = 1e-5
    for leg in (0, 1, 3):
        exact = np.array(
            [
                _paid_out(state.base[k, leg], state.platform[k, leg], radius)
                for k in range(len(state))
            ]
        )
        straight = np.linalg.norm(state.platform[:, leg] - state.base[:, leg], axis=1)
        expected = (exact - straight) / radius
        change = column.joints[leg] / state.joint_per_length[:, leg]
        assert change == pytest.approx(expected, abs=1e-4)


def test_a_cable_sags_as_a_catenary():
    """Its length by the hyperbolic cosine through both ends, at the tension of the middle."""
    state = session("cable_robot").states[1]
    weight, leg = 0.16, 2
    taut = dataclasses.replace(state, tension=np.full(state.tension.shape, 20.0))
    column = columns("cable_sag", taut)["cables"]
    for k in (0, 7, 20):
        strut = state.platform[k, leg] - state.base[k, leg]
        level, rise = np.hypot(*strut[:2]), strut[2]
        chord = np.linalg.norm(strut)
        scale = 20.0 * level / chord / weight  # horizontal force over weight
        length = np.sqrt(rise**2 + (2.0 * scale * np.sinh(0.5 * level / scale)) ** 2)
        sag = column.joints[leg][k] / state.joint_per_length[k, leg] * weight**2
        assert sag == pytest.approx(length - chord, rel=0.02)


def test_a_post_leans_as_its_anchor_displaced():
    s = session("cable_robot")
    state = s.states[1]
    column = columns("post_compliance", state)["leg 4"]
    compliance, leg = 1e-7, 3
    strut = state.platform[:, leg] - state.base[:, leg]
    level = strut.copy()
    level[:, 2] = 0.0
    pull = state.tension[:, leg, None] * level / np.linalg.norm(strut, axis=1)[:, None]
    leaning = state.base[:, leg] + compliance * pull
    # the controller pays out for the anchor as it knows it: too much by what it leans
    real = np.linalg.norm(state.platform[:, leg] - leaning, axis=1)
    nominal = np.linalg.norm(strut, axis=1)
    expected = (nominal - real) / compliance
    change = column.joints[leg] / state.joint_per_length[:, leg]
    assert change == pytest.approx(expected, rel=1e-4)


def test_a_target_off_its_place_is_another_tool():
    """What a tracker in the base frame sees of a tool that is off by a vector."""
    s = session("hexapod")
    state, place = s.states[1], np.array([0.01, -0.02, 0.05])
    offset = np.array([1e-4, -2e-4, 3e-4])
    seen = [
        s.measurement.kinematics.frames(state.pose, tool)[1]
        for tool in (place, place + offset)
    ]
    made = columns("target_offset", state)
    change = np.zeros_like(seen[0])
    for axis, amount in zip("xyz", offset, strict=True):
        column = made[f"{state.setup} {axis}"]
        change += amount * np.column_stack([column.reading[f"read_{n}"] for n in "xyz"])
    assert seen[1] - seen[0] == pytest.approx(change, abs=1e-12)
