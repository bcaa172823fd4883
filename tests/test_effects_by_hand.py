"""For each effect a number worked out in another way: by hand, from the machine's own
parameters, by virtual work.
"""

import dataclasses
import itertools

import numpy as np
import pandas as pd
import pytest
from effects_sample import columns, effect_of, session, small
from kernel.cases import CASES
from scipy.spatial.transform import Rotation

from oed.gap.data.signature import exact_readings
from oed.gap.data.state import states
from oed.measurement import Measurement
from pkm_models.effects import terms


def test_guideway_is_the_slider_joint_displaced() -> None:
    """A carriage off its line, against the parameters of the slider joint of the 3-PRS
    head.
    """
    s = session("prs_spindle")
    state, response, index = s.states[1], s.responses[1], s.measurement.machine.index
    column = columns("guideway", state)["leg 2 radial curve 1"]
    found = response.joints[0][:, :, 1] * column.joints[1][:, None]
    bend = terms.travel_curve(terms.travel_position(state)[:, 1], 0)
    out = np.array([np.cos(2.0 * np.pi / 3.0), np.sin(2.0 * np.pi / 3.0)])
    wanted = sum(
        response.parameters[0][:, :, index(f"dR2{k}")] * (bend * o)[:, None]
        for k, o in zip("xy", out, strict=True)
    )
    assert found == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("machine", ["hexapod", "a3_head", "linear_delta"])
def test_gravity_lowers_the_platform_by_the_work_it_does(machine: str) -> None:
    """Castigliano: with joints of compliance c under a weight W its place sinks by W c
    sum_i (dz/dq_i)^2: the weight's the middle of the platform's joints, a payload's the
    tool point.
    """
    s = session(machine)
    state, series, kinematics = s.states[1], s.series[1], s.measurement.kinematics
    state = dataclasses.replace(state, payload=np.full(len(state), np.nan))
    drives = columns("gravity", state)["drives"]
    theta = s.measurement.nominal
    p, tool, step = (
        theta[: len(s.case.machine.parameters)],
        np.array(s.case.setups["camera"].tool),
        1e-6,
    )

    def heights(q: np.ndarray) -> np.ndarray:
        x = kinematics.forward(q, p, series.start)
        return np.array(
            [
                kinematics.struts(x, q, p)[1].mean(axis=1)[:, 2],
                kinematics.frames(x, tool)[1][:, 2],
            ]
        )

    eye = np.eye(series.q.shape[1])
    ends = [(heights(series.q + step * e), heights(series.q - step * e)) for e in eye]
    middle, tip = np.moveaxis([(up - down) / (2.0 * step) for up, down in ends], 1, 0)
    moved = series.q + 1e-6 * np.column_stack([drives.joints[i] for i in state.limbs])
    sunk = heights(moved)[0] - heights(series.q)[0]
    assert sunk == pytest.approx(-1e-6 * np.sum(np.square(middle), axis=0), rel=1e-3)
    loaded = dataclasses.replace(
        state, payload=np.full(len(state), 300.0), max_payload=300.0
    )
    heavy = columns("gravity", loaded, ratio=2.0)["drives"]
    assert heavy.joints[0] - drives.joints[0] == pytest.approx(-0.5 * tip[0], rel=1e-5)


def test_backlash_turns_over_where_a_leg_does() -> None:
    """On a circle at constant height and tilt each leg of an A3 head turns back at an
    azimuth of its own, not all of them at the quadrants; there and back differ by b at
    each pose.
    """
    case = CASES["a3_head"]
    psi = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    circle = np.column_stack([np.full(240, 1.15), psi, np.full(240, 0.4)])
    m = Measurement(case.machine, [case.setups["camera"]])
    series = m.series(
        "camera", np.vstack([circle, circle[::-1]]), ["a"] * 240 + ["b"] * 240
    )
    (state,) = states(
        m, (series,), pd.DataFrame({"order": np.tile(np.arange(240), 2)}), m.nominal
    )
    made = columns("backlash", state)
    for i in range(3):
        behind = made[f"leg {i + 1}"].joints[i]
        wise = np.sign(np.diff(series.q[:240, i]))
        turned = np.flatnonzero(np.diff(wise)) + 1
        before = np.ones(
            239, dtype=bool
        )  # next to where it turns back the path's slope is told, not the step
        before[turned - 1] = False
        assert behind[1:240][before] == pytest.approx(-0.5 * wise[before])
        inside = slice(2, 238)
        assert len(turned) == 2
        near = np.zeros(240, dtype=bool)
        near[[k + d for k in turned for d in (-1, 0, 1)]] = True
        far = ~near[inside]
        assert np.abs(
            (behind[240:][::-1] - behind[:240])[inside][far]
        ) == pytest.approx(np.ones(far.sum()))
        quadrant = np.abs(np.angle(np.exp(4j * psi[turned]))) / 4.0
        assert (quadrant.max() > np.radians(10.0)) == (i > 0)


def test_friction_winds_up_more_where_the_leg_is_long() -> None:
    state = session("hexapod").states[0]
    strut = np.tile([[0.5], [0.75]], (1, 6))
    two = small(
        state,
        2,
        strut_length=strut,
        motion_sign=np.ones((2, 6)),
        travel_since_reversal=np.full((2, 6), np.inf),
    )
    behind = columns("friction", two)["leg 5"].joints[4]
    assert behind[1] / behind[0] == pytest.approx(1.5)
    assert behind[0] < 0.0


def test_friction_winds_up_anew_after_a_reversal() -> None:
    """Dahl: ds/dx = (1 - s sign) / d from s = -sign, here integrated in small steps;
    halfway at d log 2.
    """
    state, distance = session("hexapod").states[0], 0.5e-3
    gone = distance * np.array([0.0, np.log(2.0), 1.0, 4.0])
    wound = np.empty(4)
    for k, way in enumerate(gone):
        wound[k], steps = -1.0, 20_000
        for _ in range(steps):
            wound[k] += (1.0 - wound[k]) * way / distance / steps
    made = small(
        state,
        4,
        strut_length=np.ones((4, 6)),
        motion_sign=np.ones((4, 6)),
        travel_since_reversal=np.tile(gone[:, None], (1, 6)),
    )
    known = terms.travel(state.machine).strut_length
    behind = columns("friction", made, distance=distance)["leg 2"].joints[1]
    assert behind == pytest.approx(-wound / known[1], abs=1e-3)
    assert behind[1] == pytest.approx(0.0, abs=1e-12)


def test_servo_lag_is_where_the_joint_was_before() -> None:
    """A circle at constant feed: after T the joints are where the path was feed x T
    earlier.
    """
    case, n, radius = CASES["micro_cmm"], 360, 0.03
    m = Measurement(case.machine, [case.setups["camera_known_frame"]])

    def path(at: np.ndarray) -> np.ndarray:
        return np.column_stack(
            [radius * np.cos(at), radius * np.sin(at), np.full(len(at), -0.2)]
        )

    at = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    series = m.series("camera_known_frame", path(at), ["a"] * n)
    rows = pd.DataFrame({"order": np.arange(n), "feed": np.full(n, 0.05)})
    (state,) = states(m, (series,), rows, m.nominal)
    late = 1e-3
    _, before = m.kinematics.inverse(path(at - 0.05 * late / radius))
    made = columns("servo_lag", state)
    for i in state.limbs:
        lag = late * made[f"leg {i + 1}"].joints[i]
        assert lag[1:-1] == pytest.approx((before - series.q)[1:-1, i], abs=2e-7)
        turned = np.gradient(
            np.gradient(series.q[:, i], 0.05**-1 * radius * at), 0.05**-1 * radius * at
        )
        assert made[f"leg {i + 1} acceleration"].joints[i][3:-3] == pytest.approx(
            -turned[3:-3], rel=1e-2, abs=1e-4
        )


def test_encoder_scale_by_hand() -> None:
    state = session("planar_2dof").states[0]
    column = columns("encoder_scale", state)["leg 2"]
    assert column.scale * column.joints[1] == pytest.approx(50e-6 * state.joints[:, 1])
    assert set(column.joints) == {1}


def test_pitch_accumulation_is_a_smooth_random_curve_that_leaves_zero_and_scale_to_others() -> (
    None
):
    """Over the travel that is read its covariance is Matern's without mean and slope,
    here by Gauss quadrature.
    """
    whole = session("planar_2dof").states[0]
    nodes, weights = np.polynomial.legendre.leggauss(len(whole))
    low, high = whole.joint_range
    state = dataclasses.replace(
        whole, joints=low + 0.5 * (nodes[:, None] + 1.0) * (high - low)
    )
    made = [
        c for c in columns("pitch_accumulation", state).values() if c.label == "leg 1"
    ]
    curves = np.column_stack([c.scale / 10e-6 * c.joints[0] for c in made])
    assert np.abs(weights @ curves).max() < 1e-3
    assert np.abs((weights * nodes) @ curves).max() < 1e-3
    far = np.sqrt(3.0) / 0.5 * np.abs(nodes[:, None] - nodes)
    straight = np.column_stack([np.ones_like(nodes), nodes])
    left = np.eye(len(nodes)) - straight @ np.linalg.solve(
        straight.T @ (weights[:, None] * straight), straight.T * weights
    )
    wanted = left @ ((1.0 + far) * np.exp(-far)) @ left.T
    assert weights @ np.diag(curves @ curves.T) == pytest.approx(
        weights @ np.diag(wanted), rel=0.02
    )
    inside = np.abs(nodes) < 0.9
    assert (curves @ curves.T)[inside][:, inside] == pytest.approx(
        wanted[inside][:, inside], abs=0.02
    )


def test_a_place_is_in_the_travel_that_the_session_has_of_a_joint() -> None:
    """From -1 to 1 over what all set-ups read; over a quarter of the joint's whole
    travel where they read less.
    """
    whole = session("hexapod").states
    places = np.vstack([terms.travel_position(s) for s in whole])
    assert places.min(axis=0) == pytest.approx(-np.ones(6))
    assert places.max(axis=0) == pytest.approx(np.ones(6))
    known, state = terms.travel(whole[0].machine), whole[0]
    middle = state.joints.mean(axis=0)
    short = dataclasses.replace(
        state, joint_range=np.array([middle - 1e-3, middle + 1e-3])
    )
    slope = terms.travel_position(
        dataclasses.replace(short, joints=state.joints + 1e-3)
    ) - terms.travel_position(short)
    assert slope == pytest.approx(
        np.broadcast_to(2e-3 / (0.25 * (known.high - known.low)), slope.shape)
    )


@pytest.mark.parametrize(("name", "constant", "period"), [
    ("screw_cyclic", "pitch", 5e-3), ("encoder_subdivision", "period", 20e-6),
])  # fmt: skip
def test_cyclic_errors_come_back_after_a_period(
    name: str, constant: str, period: float
) -> None:
    state = session("hexapod").states[0]
    q = np.tile(0.6 + period * np.array([[0.0], [0.25], [0.5], [1.0]]), (1, 6))
    made = columns(name, small(state, 4, joints=q), **{constant: period})
    for k, expected in ((1, [1.0, 0.0, -1.0, 1.0]), (2, [1.0, -1.0, 1.0, 1.0])):
        assert made[f"leg 1 cos {k}"].joints[0] == pytest.approx(expected, abs=1e-6)
    wanted = {"screw_cyclic": 3e-6, "encoder_subdivision": 0.1e-6}[name]
    assert made["leg 1 sin 1"].scale == pytest.approx(wanted)
    assert period in effect_of(name).constants[constant]


def test_joint_runout_goes_twice_a_turn() -> None:
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
    sizes = {1: 1.6e-6, 2: 4e-6, 3: 4e-6, 12: 0.6e-6}
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


def test_joint_runout_at_the_platform_turns_with_it() -> None:
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
        assert len(before) == 6 * 2 * (
            6 + 3
        )  # legs, sine and cosine, orders along and sideways
        for name, c in before.items():
            (i,) = c.joints
            assert after[name].joints[i] == pytest.approx(c.joints[i])


def test_joint_runout_at_the_platform_is_of_its_joint_s_angle() -> None:
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


def test_joint_clearance_changes_sides_with_the_load() -> None:
    """Standing legs are pressed; 400 N upwards on a platform of 200 N pulls them."""
    state = session("hexapod").states[0]
    even = np.full((2, 6), -0.2)
    two = small(
        state,
        2,
        tool_force=even,
        platform_force=even,
        payload=np.array([0.0, -400.0]),
        max_payload=400.0,
    )
    column = columns("joint_clearance", two, ratio=0.5)["leg 6"]
    assert column.scale * column.joints[5] == pytest.approx([-5e-6, 5e-6])


def test_joint_clearance_is_taken_up_by_the_load_that_statics_give() -> None:
    """Forces and moments of six struts on the platform balance its weight and payload:
    some of the play is taken up.
    """
    state = session("hexapod").states[1]
    lever = np.cross(state.platform - state.tool[:, None], state.strut_direction)
    struts = np.concatenate([state.strut_direction, lever], axis=-1).transpose(0, 2, 1)
    down, middle = (
        np.array([0.0, 0.0, -600.0]),
        state.platform.mean(axis=1) - state.tool,
    )
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


def test_joint_clearance_that_differs_along_the_travel_is_play() -> None:
    """At a place s of its travel a leg has (1 + s / 2) of its play, on whichever side
    its load is.
    """
    state = session("hexapod").states[0]
    even = np.full((2, 6), -0.2)
    two = small(
        state,
        2,
        tool_force=even,
        platform_force=even,
        payload=np.array([0.0, -400.0]),
        max_payload=400.0,
    )
    two = dataclasses.replace(two, joints=two.joints[[0, 0]])
    made = columns("joint_clearance", two, ratio=0.5)
    play = made["leg 6"].joints[5] + 0.5 * made["leg 6 slope"].joints[5]
    assert play[0] == pytest.approx(-play[1])
    assert abs(play[0]) == pytest.approx(
        0.5 * (1.0 + 0.5 * abs(terms.travel_position(two)[0, 5]))
    )


@pytest.mark.parametrize("machine", CASES)
def test_pushing_displaces_the_tool_as_it_says(machine: str) -> None:
    """By differences of the forward kinematics: along each axis that the machine has; a
    hexapod does not turn.
    """
    s, step = session(machine), 1e-5
    kinematics, p = (
        s.measurement.kinematics,
        s.measurement.nominal[: len(s.case.machine.parameters)],
    )
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
def test_frame_bending_displaces_what_a_camera_sees(
    machine: str, middle: tuple[float, float, float], lever: float
) -> None:
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
    start, able = (
        m.readings([series], theta),
        "yz" if machine == "planar_2dof" else "xyz",
    )
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


def test_constant_and_linear_bending_is_what_the_payload_makes_of_it() -> None:
    """From no payload to the heaviest: by 6 um, or 6 um times a coordinate, times the
    sag more.
    """
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
