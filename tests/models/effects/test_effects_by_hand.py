"""For each effect a number worked out in another way: by hand, from the machine's own
parameters, by virtual work.
"""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from effects_sample import columns, effect_of, session, small

from kernel.cases import CASES
from oed.gap import states
from oed.measurement import Measurement
from pkm_models.effects import terms


def test_guideway_is_the_slider_joint_displaced():
    """A carriage off its line, against the parameters of the slider joint of the 3-PRS head."""
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


#: first column of an effect, and the sizes that its source publishes, SI
PUBLISHED = {
    "backlash": ("leg 1", 5e-6, 50e-6),  # ball screws without preload
    "bar_length": ("camera bar", 10e-6, 10e-6),  # an unzeroed bar
    "cable_stretch": ("cables", 5e-6, 50e-6),  # a steel rope; a braided fibre, 1/N
    "drum_runout": ("leg 1 sin 1", 50e-6, 0.2e-3),  # turned drums
    "encoder_subdivision": ("leg 1 sin 1", 0.0, 0.005 * 10e-6),  # 1 % end to end
    "friction": ("leg 1", 1e-6, 5e-6),
    "gear_eccentricity": ("leg 1 sin 1", 20e-6 / 0.1, 40e-6 / 0.1),  # F_r / d
    "gravity": ("drives", 1e3 / 50e6, 1e3 / 50e6),  # m a kN on legs of 50 N/um
    "guideway": ("leg 1 radial curve 1", 5e-6, 20e-6),
    "joint_clearance": ("leg 1", 5e-6, 20e-6),
    "joint_runout": ("leg 1 2 sin", 1e-6, 5e-6),
    "leg_thermal": ("leg 1 rise", 2.0, 10.0),  # K
    "mount_drift": ("set-up camera cup_x", 1e-6, 5e-6),
    "screw_cyclic": ("leg 1 sin 1", 3e-6, 4e-6),  # 6 to 8 um end to end
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_expected_size_is_one_that_the_source_publishes(name):
    column, least, most = PUBLISHED[name]
    scale = columns(name, session("hexapod").states[1])[column].scale
    assert least * (1.0 - 1e-9) <= scale <= most * (1.0 + 1e-9)


@pytest.mark.parametrize("machine", ["hexapod", "a3_head", "linear_delta"])
def test_gravity_lowers_the_platform_by_the_work_it_does(machine):
    """Castigliano: with joints of compliance c under a weight W its place sinks by W c
    sum_i (dz/dq_i)^2: the weight's the middle of the platform's joints, a payload's the
    tool point.
    """
    s = session(machine)
    state, series, kinematics = s.states[1], s.series[1], s.measurement.kinematics
    state = dataclasses.replace(state, payload=np.full(len(state), np.nan))
    drives = columns("gravity", state)["drives"]
    theta = s.measurement.nominal
    p = theta[: len(s.case.machine.parameters)]
    tool = np.array(s.case.setups["camera"].tool)
    step = 1e-6

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


def test_backlash_turns_over_where_a_leg_does():
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
        # next to where it turns back the path's slope is told, not the step
        before = np.ones(239, dtype=bool)
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


def test_friction_winds_up_more_where_the_leg_is_long():
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


def test_friction_winds_up_anew_after_a_reversal():
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
    known = terms.travel(state.machine).strut
    behind = columns("friction", made, distance=distance)["leg 2"].joints[1]
    assert behind == pytest.approx(-wound / known[1], abs=1e-3)
    assert behind[1] == pytest.approx(0.0, abs=1e-12)


def test_servo_lag_is_where_the_joint_was_before():
    """A circle at constant feed: after T the joints are where the path was feed x T earlier."""
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


def test_encoder_scale_by_hand():
    state = session("planar_2dof").states[0]
    column = columns("encoder_scale", state)["leg 2"]
    travel = state.joints[:, 1]
    middle = 0.5 * (travel.min() + travel.max())
    assert column.scale * column.joints[1] == pytest.approx(50e-6 * (travel - middle))
    assert set(column.joints) == {1}


def test_pitch_accumulation_is_a_smooth_random_curve_about_a_slope():
    """Over the travel that is read its covariance is Matern's without mean and slope,
    here by Gauss quadrature.
    """
    whole = session("planar_2dof").states[0]
    nodes, weights = np.polynomial.legendre.leggauss(len(whole))
    low, high = whole.joint_range
    state = dataclasses.replace(
        whole, joints=low + 0.5 * (nodes[:, None] + 1.0) * (high - low)
    )
    made = columns("pitch_accumulation", state)
    slope = made["leg 1 slope"]
    assert slope.shape
    assert slope.joints[0] == pytest.approx(nodes)
    of_leg = [c for n, c in made.items() if c.label == "leg 1" and "curve" in n]
    curves = np.column_stack([c.scale / 10e-6 * c.joints[0] for c in of_leg])
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


def test_a_place_is_in_the_travel_that_the_session_has_of_a_joint():
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
def test_cyclic_errors_come_back_after_a_period(name, constant, period):
    state = session("hexapod").states[0]
    q = np.tile(0.6 + period * np.array([[0.0], [0.25], [0.5], [1.0]]), (1, 6))
    made = columns(name, small(state, 4, joints=q), **{constant: period})
    for k, expected in ((1, [1.0, 0.0, -1.0, 1.0]), (2, [1.0, -1.0, 1.0, 1.0])):
        assert made[f"leg 1 cos {k}"].joints[0] == pytest.approx(expected, abs=1e-6)
    wanted = {"screw_cyclic": 3e-6, "encoder_subdivision": 0.1e-6}[name]
    assert made["leg 1 sin 1"].scale == pytest.approx(wanted)
    assert period in effect_of(name).constants[constant]
