"""Effects of joints, of the frame and of rotary drives, against closed forms by hand."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from effects_sample import columns, effect_of, session, small
from scipy import optimize
from scipy.spatial.transform import Rotation
from shipped_models import five_bar, hexapod_rus

from kernel.cases import CASES
from oed.gap import exact_readings
from pkm_models.effects import terms


def test_joint_runout_goes_twice_a_turn():
    """Upright, 45 degrees outwards, 45 degrees across: an eighth of the joint's turn is
    a quarter of the error's.
    """
    state = small(session("hexapod").states[0], 3)
    up, out = np.array([0.0, 0.0, 1.0]), terms.radial_directions(state)[1, 3]
    across = np.array([-out[1], out[0], 0.0])
    along, half = state.strut_direction.copy(), np.sqrt(0.5)
    along[:, 3] = up, half * (out + up), half * (across + up)
    swung = dataclasses.replace(state, strut_direction=along)
    wanted = {
        (2, 0.0): ([0.0, 1.0, 0.0], [1.0, 0.0, 1.0]),
        (1, 0.0): ([0.0, half, 0.0], [1.0, half, 1.0]),
        (3, 0.0): ([0.0, half, 0.0], [1.0, -half, 1.0]),
        (12, 0.0): ([0.0, 0.0, 0.0], [1.0, -1.0, 1.0]),
        (2, 1.0): ([0.0, 0.0, 1.0], [1.0, 1.0, 0.0]),
    }
    sizes = {1: 1.6e-6, 2: 4e-6, 3: 8e-6 / 3, 12: 8e-6 / 12}
    for (order, way), waves in wanted.items():
        made = columns("joint_runout", swung, platform=0.0, across=way)
        for part, wave in zip(("sin", "cos"), waves, strict=True):
            column = made[f"leg 4 {order} {part}"]
            assert column.scale * column.joints[3] == pytest.approx(
                sizes[order] * np.array(wave), abs=1e-14
            )
            assert column.shape == (order != 2)
    beside = columns("joint_runout", swung, platform=0.0, across=0.0)[
        "leg 4 sideways 1 cos"
    ]
    assert beside.shape
    assert beside.scale * beside.joints[3] == pytest.approx(
        [0.0, 0.0, 1.6e-6 * half], abs=1e-14
    )
    assert not columns("joint_runout", session("linear_delta").states[0], platform=1.0)


def test_joint_runout_at_the_platform_turns_with_it():
    """Turning machine and platform together about the vertical leaves the joints'
    angles as they are.
    """
    state = session("hexapod").states[0]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = dataclasses.replace(
        state,
        base=state.base @ turn.T,
        platform=state.platform @ turn.T,
        strut_direction=state.strut_direction @ turn.T,
    )
    for end, way in itertools.product((0.0, 1.0), (0.0, 1.0)):
        before, after = (
            columns("joint_runout", s, platform=end, across=way)
            for s in (state, turned)
        )
        # legs, sine and cosine, orders 1 to 12 and 16 along and three sideways
        assert len(before) == 6 * 2 * (13 + 3)
        for name, c in before.items():
            (i,) = c.joints
            assert after[name].joints[i] == pytest.approx(c.joints[i])


def test_joint_runout_at_the_platform_is_of_its_joint_s_angle():
    """A platform that tilts by 0.1 rad in a leg's plane, under a strut that stays,
    turns that joint by 0.1 rad.
    """
    state, i, angle = session("hexapod").states[0], 3, 0.1
    tilted = state.platform.copy()
    for k, ends in enumerate(state.platform):
        middle = ends.mean(axis=0)
        normal = np.linalg.svd(ends - middle)[2][2]
        axis = np.cross(normal, ends[i] - middle)
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
        tilted[k] = middle + turn.apply(ends - middle)
    turned = dataclasses.replace(state, platform=tilted)
    before, after = (
        columns("joint_runout", s, platform=1.0, across=0.0) for s in (state, turned)
    )
    for order in (1, 2, 3, 8):
        waves = [
            made[f"leg 4 {order} cos"].joints[i]
            + 1j * made[f"leg 4 {order} sin"].joints[i]
            for made in (before, after)
        ]
        assert np.abs(waves[0]) == pytest.approx(1.0)
        assert np.abs(np.angle(waves[1] / waves[0])) == pytest.approx(order * angle)


def pressed_and_pulled(state: Any) -> Any:
    """Two poses with 400 N upwards on the second."""
    load = {"payload": np.array([0.0, -400.0]), "max_payload": 400.0}
    even = np.full((2, 6), -0.2)
    return small(state, 2, tool_force=even, platform_force=even, **load)


def test_joint_clearance_changes_sides_with_the_load():
    """Standing legs are pressed; 400 N upwards on a platform of 200 N pulls them."""
    state = session("hexapod").states[0]
    two = pressed_and_pulled(state)
    column = columns("joint_clearance", two, ratio=0.5)["leg 6"]
    assert column.scale * column.joints[5] == pytest.approx([-5e-6, 5e-6])


def test_joint_clearance_is_taken_up_by_the_load_that_statics_give():
    """Forces and moments of six struts on the platform balance its weight and payload:
    some of the play is taken up.
    """
    state = session("hexapod").states[1]
    lever = np.cross(state.platform - state.tool[:, None], state.strut_direction)
    struts = np.concatenate([state.strut_direction, lever], axis=-1).transpose(0, 2, 1)
    down = np.array([0.0, 0.0, -600.0])
    middle = state.platform.mean(axis=1) - state.tool
    weight = np.hstack([np.tile(down, (len(state), 1)), np.cross(middle, down)])
    weight[:, 2] -= state.payload  # at the tool
    tension = np.linalg.solve(struts, weight[..., None])[..., 0]
    assert (tension < 0.0).all()
    assert state.payload.max() > 0.0
    made = columns("joint_clearance", state, ratio=600.0 / state.max_payload, soft=0.2)
    for i in range(6):
        for name, play, soft in (("", 10e-6, 0.2), (" harder", 4e-6, 0.06)):
            column = made[f"leg {i + 1}{name}"]
            wanted = 0.5 * play * np.tanh(tension[:, i] / (soft * 600.0))
            assert column.scale * column.joints[i] == pytest.approx(wanted)
            assert column.shape == bool(name)


def test_joint_clearance_that_differs_along_the_travel_is_play():
    """At a place s of its travel a leg has (1 + s / 2) of its play, on whichever side
    its load is.
    """
    state = session("hexapod").states[0]
    two = pressed_and_pulled(state)
    two = dataclasses.replace(two, joints=two.joints[[0, 0]])
    made = columns("joint_clearance", two, ratio=0.5)
    play = made["leg 6"].joints[5] + 0.5 * made["leg 6 slope"].joints[5]
    assert play[0] == pytest.approx(-play[1])
    assert abs(play[0]) == pytest.approx(
        0.5 * (1.0 + 0.5 * abs(terms.travel_position(two)[0, 5]))
    )


@pytest.mark.parametrize("machine", CASES)
def test_pushing_displaces_the_tool_as_it_says(machine):
    """By differences of the forward kinematics: along each axis that the machine has; a
    hexapod does not turn.
    """
    s, step = session(machine), 1e-5
    kinematics = s.measurement.kinematics
    p = s.measurement.nominal[: len(s.case.machine.parameters)]
    for state, series in zip(s.states, s.series, strict=True):
        tool = np.array(s.measurement.setups[series.setup].tool)
        for k, axis in enumerate(np.eye(3)):
            change = step * state.joints_per_displacement[:, :, k]
            if machine == "planar_2dof" and k == 0:
                assert change == pytest.approx(0.0, abs=1e-12 * step)
                continue
            ends = [
                kinematics.frames(
                    kinematics.forward(series.q + sign * change, p, series.start), tool
                )
                for sign in (0.5, -0.5)
            ]
            assert (ends[0][1] - ends[1][1]) / step == pytest.approx(
                np.tile(axis, (len(state), 1)), abs=1e-5
            )
            if machine == "hexapod":
                assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-5 * step)


@pytest.mark.parametrize(("machine", "middle", "lever"), [
    ("a3_head", (0.0, 0.0, 1.166), 0.54), ("linear_delta", (0.0, 0.0, 0.2), 0.16175),
    ("planar_2dof", (0.0, 0.0, 0.75), 1.0),
])  # fmt: skip
def test_frame_bending_displaces_what_a_camera_sees(machine, middle, lever):
    """By 20 um times a product of two coordinates of the tool, 8 um times one of three,
    along the axis named alone, and by a fifth more of it under the heaviest payload.
    """
    s = session(machine)
    m, theta, (state, series) = (
        s.measurement,
        s.measurement.nominal,
        (s.states[1], s.series[1]),
    )
    pose = dict(
        zip([c.name for c in m.machine.pose], m.poses(series, theta).T, strict=True)
    )
    zero, more = np.zeros(len(state)), 1.0 + 0.2 * state.payload / 150.0
    at = {
        k: (pose.get(k, zero) - c) / lever for k, c in zip("xyz", middle, strict=True)
    }
    start = m.readings([series], theta)
    able = "yz" if machine == "planar_2dof" else "xyz"
    made, acting = columns("frame_bending", state, sag=0.2), set()
    for name, column in made.items():
        axis, _, factors = name.partition(" by ")
        assert column.shape == (len(factors) != 2)
        if len(factors) < 2:
            continue
        field = (
            {2: 20e-6, 3: 8e-6, 4: 4e-6}[len(factors)]
            * np.prod([at[k] for k in factors], axis=0)
            * more
        )
        seen = (
            exact_readings(
                m,
                [series],
                theta,
                [state],
                [(effect_of("frame_bending"), {"sag": 0.2}, {name: 1.0})],
            )
            - start
        )
        wanted = np.column_stack(
            [field if k == axis and k in able else zero for k in "xyz"]
        )
        assert seen.reshape(-1, 3) == pytest.approx(
            wanted, abs=1e-3 * np.abs(wanted).max() + 1e-14
        )
        acting |= {name} if wanted.any() else set()
    forms = [
        f
        for n in range(2, 7 - len(able))
        for f in itertools.combinations_with_replacement(able, n)
    ]
    assert acting == {f"{axis} by {''.join(form)}" for axis in able for form in forms}


def test_constant_and_linear_bending_is_what_the_payload_makes_of_it():
    """From no payload to the heaviest: by 6 um, or 6 um times a coordinate, times the sag more."""
    state = session("hexapod").states[0]
    pose = np.repeat(state.pose[:1] + 0.1, 4, axis=0)
    loads = np.array([0.0, 200.0, 200.0, np.nan])
    loaded = small(state, 4, pose=pose, payload=loads, max_payload=200.0)
    made = columns("frame_bending", loaded, sag=0.5)
    offset = {c.name: p for c, p in zip(state.machine.pose, pose[0], strict=True)}
    middle = {c.name: 0.5 * (c.lower + c.upper) for c in state.machine.command}
    x = (offset["x"] - middle.get("x", 0.0)) / state.machine.lever
    for name, size in (("z", 1.0), ("z by x", x)):
        change = (
            np.column_stack([made[name].joints[i] for i in range(6)]) * made[name].scale
        )
        share = 0.5 * np.array([0.0, 1.0, 1.0, 0.0])
        assert change == pytest.approx(
            6e-6 * size * share[:, None] * loaded.joints_per_displacement[:, :, 2]
        )


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
