"""For each effect a number worked out in another way: by hand, from the machine's own parameters, by virtual work."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from effects_sample import HOURS, ROUND, columns, effect_of, session, small
from kernel.cases import CASES

from oed.gap.signature import exact, signature
from oed.gap.state import states
from oed.measurement import Measurement
from pkm_models.effects import terms


def test_leg_thermal_by_hand() -> None:
    """0.6 m of steel, 2 K: 13.8 um; without a sensor 63.2 % of the final rise after one time constant."""
    state = session("hexapod").states[0]
    known = {"strut": np.full((2, 6), 0.6), "per_length": np.ones((2, 6))}
    warm = columns("leg_thermal", small(state, 2, temperature={"leg": np.array([21.0, 23.0])}, **known))[
        "leg 3 per kelvin"
    ]
    assert warm.scale * warm.joints[2] == pytest.approx([0.0, 13.8e-6])
    timed = small(state, 2, time=np.array([0.0, 3600.0]), session=np.linspace(0.0, 3600.0, 61), **known)
    rise = columns("leg_thermal", timed, tau=3600.0)["leg 3 rise"]
    assert rise.joints[2] == pytest.approx([0.0, 11.5e-6 * 0.6 * (1.0 - np.exp(-1.0))])
    own = small(state, 2, temperature={"leg3": np.array([0.0, 1.0])}, **known)
    assert columns("leg_thermal", own)["leg 3 per kelvin"].joints[2] == pytest.approx([0.0, 0.6])


def test_what_warms_at_work_cools_in_breaks() -> None:
    """Ten runs of ten minutes, a break of two hours, and ten more: cooled by exp(-7200 / tau) over the break."""
    state = session("hexapod").states[0]
    first = np.concatenate([600.0 * k + np.arange(0.0, 301.0, 10.0) for k in range(10)])
    both = np.concatenate([first, first + first[-1] + 7200.0])
    before, after = float(first[-1]), float(first[-1] + 7200.0)
    timed = small(state, 2, time=np.array([before, after]), session=both)
    share = terms.warming(timed, "leg", 5400.0)[1]
    assert share[0] == pytest.approx(1.0 - np.exp(-before / 5400.0))
    assert share[1] == pytest.approx(share[0] * np.exp(-7200.0 / 5400.0))


def test_a_body_lags_behind_its_sensor() -> None:
    """Behind a ramp of slope a from rest, a body of time constant T is a T (1 - exp(-t / T)) behind."""
    state, time = session("hexapod").states[0], np.linspace(0.0, 7200.0, 10)
    ramp = small(state, 10, time=time, temperature={"leg": 1e-3 * time})
    measured, rise, behind = terms.warming(ramp, "leg", 1800.0)
    assert measured
    assert rise == pytest.approx(1e-3 * time)
    assert behind == pytest.approx(-1.8 * (1.0 - np.exp(-time / 1800.0)))


@pytest.mark.parametrize("machine", ["planar_2dof", "a3_head", "prs_spindle"])
def test_frame_thermal_is_the_base_joints_moving_apart(machine: str) -> None:
    """As the machine's own parameters of its base joints would have it."""
    s = session(machine)
    m, state, response = s.measurement, s.states[1], s.responses[1]
    (column,) = [c for c in columns("frame_thermal", state, tau=3600.0).values() if not c.shape]
    found = sum(response.joints[0][:, :, i] * v[:, None] for i, v in column.joints.items())
    growth = 11.5e-6 * -np.expm1(-state.time / 3600.0)
    if machine == "planar_2dof":
        wanted = response.parameters[0][:, :, m.machine.index("D")] * (3.584 * growth)[:, None]
    else:
        stem, radius, turn = ("db", 0.250, -0.5 * np.pi) if machine == "a3_head" else ("dR", 0.349, 0.0)
        wanted = np.zeros_like(found)
        for i in range(3):
            angle = turn + 2.0 * np.pi * i / 3.0
            for k, part in (("x", np.cos(angle)), ("y", np.sin(angle))):
                slope = response.parameters[0][:, :, m.machine.index(f"{stem}{i + 1}{k}")]
                wanted += slope * (radius * part * growth)[:, None]
    assert found == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())


def test_guideway_is_the_slider_joint_displaced() -> None:
    """A carriage off its line, against the parameters of the slider joint of the 3-PRS head."""
    s = session("prs_spindle")
    state, response, index = s.states[1], s.responses[1], s.measurement.machine.index
    column = columns("guideway", state)["leg 2 radial P2"]
    found = response.joints[0][:, :, 1] * column.joints[1][:, None]
    bend = 0.5 * (3.0 * terms.place(state)[:, 1] ** 2 - 1.0)
    out = np.array([np.cos(2.0 * np.pi / 3.0), np.sin(2.0 * np.pi / 3.0)])
    wanted = sum(
        response.parameters[0][:, :, index(f"dR2{k}")] * (bend * o)[:, None] for k, o in zip("xy", out, strict=True)
    )
    assert found == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("machine", ["hexapod", "a3_head", "linear_delta"])
def test_gravity_lowers_the_tool_by_the_work_it_does(machine: str) -> None:
    """Castigliano: with joints of compliance c under a weight W at the tool point it sinks by W c sum_i (dz/dq_i)^2."""
    s = session(machine)
    state, series, kinematics = s.states[1], s.series[1], s.measurement.kinematics
    state = dataclasses.replace(state, payload=np.full(len(state), np.nan))
    drives = columns("gravity", state)["drives"]
    theta = s.measurement.nominal
    p, tool, step = theta[: len(s.case.machine.parameters)], np.array(s.case.setups["camera"].tool), 1e-6

    def height(q: np.ndarray) -> np.ndarray:
        return kinematics.frames(kinematics.forward(q, p, series.start), tool)[1][:, 2]

    slopes = [
        (height(series.q + step * e) - height(series.q - step * e)) / (2.0 * step) for e in np.eye(series.q.shape[1])
    ]
    moved = series.q + 1e-6 * np.column_stack([drives.joints[i] for i in state.limbs])
    assert height(moved) - height(series.q) == pytest.approx(-1e-6 * np.sum(np.square(slopes), axis=0), rel=1e-3)
    heavy = columns("gravity", dataclasses.replace(state, payload=np.full(len(state), 300.0)), weight=600.0)["drives"]
    assert heavy.joints[0] == pytest.approx(1.5 * drives.joints[0])


def test_backlash_turns_over_where_a_leg_does() -> None:
    """On a circle at constant height and tilt each leg of an A3 head turns back at an azimuth of its own, not all of
    them at the quadrants; there and back differ by b at each pose."""
    case = CASES["a3_head"]
    psi = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    circle = np.column_stack([np.full(240, 1.15), psi, np.full(240, 0.4)])
    m = Measurement(case.machine, [case.setups["camera"]])
    series = m.series("camera", np.vstack([circle, circle[::-1]]), ["a"] * 240 + ["b"] * 240)
    (state,) = states(m, (series,), pd.DataFrame({"order": np.tile(np.arange(240), 2)}), m.nominal)
    made = columns("backlash", state)
    for i in range(3):
        behind = made[f"leg {i + 1}"].joints[i]
        wise = np.sign(np.diff(series.q[:240, i]))
        turned = np.flatnonzero(np.diff(wise)) + 1
        before = np.ones(239, dtype=bool)  # next to where it turns back the path's slope is told, not the step
        before[turned - 1] = False
        assert behind[1:240][before] == pytest.approx(-0.5 * wise[before])
        inside = slice(2, 238)
        assert len(turned) == 2
        near = np.zeros(240, dtype=bool)
        near[[k + d for k in turned for d in (-1, 0, 1)]] = True
        far = ~near[inside]
        assert np.abs((behind[240:][::-1] - behind[:240])[inside][far]) == pytest.approx(np.ones(far.sum()))
        quadrant = np.abs(np.angle(np.exp(4j * psi[turned]))) / 4.0
        assert (quadrant.max() > np.radians(10.0)) == (i > 0)


def test_friction_winds_up_more_where_the_leg_is_long() -> None:
    state = session("hexapod").states[0]
    strut = np.tile([[0.5], [0.75]], (1, 6))
    two = small(state, 2, strut=strut, sense=np.ones((2, 6)))
    behind = columns("friction", two)["leg 5"].joints[4]
    assert behind[1] / behind[0] == pytest.approx(1.5)
    assert behind[0] < 0.0


def test_servo_lag_is_where_the_joint_was_before() -> None:
    """A circle at constant feed: after T the joints are where the path was feed x T earlier."""
    case, n, radius = CASES["micro_cmm"], 360, 0.03
    m = Measurement(case.machine, [case.setups["camera_known_frame"]])

    def path(at: np.ndarray) -> np.ndarray:
        return np.column_stack([radius * np.cos(at), radius * np.sin(at), np.full(len(at), -0.2)])

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
        turned = np.gradient(np.gradient(series.q[:, i], 0.05**-1 * radius * at), 0.05**-1 * radius * at)
        assert made[f"leg {i + 1} acceleration"].joints[i][3:-3] == pytest.approx(-turned[3:-3], rel=1e-2, abs=1e-4)


def test_encoder_scale_by_hand() -> None:
    state = session("planar_2dof").states[0]
    column = columns("encoder_scale", state)["leg 2"]
    assert column.scale * column.joints[1] == pytest.approx(50e-6 * state.joints[:, 1])
    assert set(column.joints) == {1}


def test_pitch_accumulation_leaves_zero_and_scale_to_others() -> None:
    """Over the travel, found here by brute force, its curves have neither mean nor slope."""
    case = CASES["planar_2dof"]
    corners = np.array([[y, z] for y in np.linspace(-1.5, 1.5, 31) for z in (0.0, 1.5)])
    _, q = Measurement(case.machine, []).kinematics.inverse(corners)
    state = small(session("planar_2dof").states[0], 49)
    nodes, weights = np.polynomial.legendre.leggauss(len(state))
    at = q.min(axis=0) + 0.5 * (nodes[:, None] + 1.0) * np.ptp(q, axis=0)
    for c in columns("pitch_accumulation", dataclasses.replace(state, joints=at)).values():
        (curve,) = c.joints.values()
        assert abs(weights @ curve) < 1e-6
        assert abs(weights @ (curve * nodes)) < 1e-6
        assert weights @ curve**2 > 0.1


@pytest.mark.parametrize(("name", "constant", "period"), [
    ("screw_cyclic", "pitch", 5e-3), ("encoder_subdivision", "period", 20e-6),
])  # fmt: skip
def test_cyclic_errors_come_back_after_a_period(name: str, constant: str, period: float) -> None:
    state = session("hexapod").states[0]
    q = np.tile(0.6 + period * np.array([[0.0], [0.25], [0.5], [1.0]]), (1, 6))
    made = columns(name, small(state, 4, joints=q), **{constant: period})
    for k, expected in ((1, [1.0, 0.0, -1.0, 1.0]), (2, [1.0, -1.0, 1.0, 1.0])):
        assert made[f"leg 1 cos {k}"].joints[0] == pytest.approx(expected, abs=1e-6)
    wanted = {"screw_cyclic": 3e-6, "encoder_subdivision": 0.1e-6}[name]
    assert made["leg 1 sin 1"].scale == pytest.approx(wanted)
    assert period in effect_of(name).constants[constant]


def test_joint_runout_goes_twice_a_turn() -> None:
    """A strut that leans outwards by 45 degrees is a quarter of its turn from an upright one."""
    state = small(session("hexapod").states[0], 2)
    out = terms.radial(state)[1, 3]
    along = state.along.copy()
    along[0, 3], along[1, 3] = (0.0, 0.0, 1.0), np.sqrt(0.5) * (out + np.array([0.0, 0.0, 1.0]))
    made = columns("joint_runout", dataclasses.replace(state, along=along))
    assert made["leg 4 base cos"].joints[3] == pytest.approx([1.0, 0.0], abs=1e-12)
    assert made["leg 4 base sin"].joints[3] == pytest.approx([0.0, 1.0])
    assert not any("platform" in n for n in columns("joint_runout", session("linear_delta").states[0]))


def test_joint_runout_at_the_platform_turns_with_it() -> None:
    """Turning machine and platform together about the vertical leaves the joints' angles as they are."""
    state = session("hexapod").states[0]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = dataclasses.replace(
        state, base=state.base @ turn.T, platform=state.platform @ turn.T, along=state.along @ turn.T
    )
    before, after = columns("joint_runout", state), columns("joint_runout", turned)
    assert len(before) == 24
    for name, c in before.items():
        (i,) = c.joints
        assert after[name].joints[i] == pytest.approx(c.joints[i])


def test_joint_clearance_changes_sides_with_the_load() -> None:
    """Standing legs are pressed; 400 N upwards on a platform of 200 N pulls them."""
    state = session("hexapod").states[0]
    two = small(state, 2, force=np.full((2, 6), -0.2), payload=np.array([0.0, -400.0]))
    column = columns("joint_clearance", two, weight=200.0)["leg 6"]
    assert column.scale * column.joints[5] == pytest.approx([-5e-6, 5e-6])


def test_bar_length_is_a_constant_of_bars_alone() -> None:
    s = session("a3_head")
    found = signature(effect_of("bar_length"), {}, s.states, s.responses, s.measurement, s.series)
    bar = 2 * ROUND
    assert found.names == ("bar 300 mm",)
    assert found.columns[:bar, 0] == pytest.approx(np.full(bar, 10e-6))
    assert not found.columns[bar:].any()


def test_bar_thermal_by_hand() -> None:
    """A bar of 0.3 m, 2 K warmer, is 6.9 um longer and reads that much less."""
    state = small(session("a3_head").states[0], 2, temperature={"bar": np.array([20.0, 22.0])})
    (column,) = [c for c in columns("bar_thermal", state).values() if not c.shape]
    assert column.scale * column.reading["length"] == pytest.approx([0.0, -6.9e-6])


def test_mount_drift_is_a_cup_elsewhere_at_the_end() -> None:
    s = session("a3_head")
    m, theta = s.measurement, s.measurement.nominal
    name = "ball_bar cup_x"
    drifted = exact(m, s.series, theta, s.states, [(effect_of("mount_drift"), {}, {name: 1.0})])
    away = theta.copy()
    away[m.names.index("ball_bar.cup_x")] = 5e-6
    start, moved = m.readings(s.series, theta), m.readings(s.series, away)
    share = s.states[0].time[: 2 * ROUND] / HOURS
    assert (drifted - start)[: 2 * ROUND] == pytest.approx(
        share * (moved - start)[: 2 * ROUND], abs=2e-11
    )  # a circle is not a line
    assert drifted[2 * ROUND :] == pytest.approx(start[2 * ROUND :], abs=1e-15)


def test_mount_drift_of_a_laser_without_unknowns_is_in_its_readings() -> None:
    state = session("planar_2dof").states[0]
    made = columns("mount_drift", dataclasses.replace(state, setup="rm1"))
    assert made["rm1 dy"].reading["dy"] == pytest.approx(state.time / HOURS)


def test_step_begins_when_it_is_said() -> None:
    state = session("planar_2dof").states[0]
    made = columns("step", state, when=0.25)
    late = state.time >= 0.25 * HOURS
    assert 0 < late.sum() < len(state)
    assert made["leg 1"].joints == {0: pytest.approx(late.astype(float))}
    assert made["set-up ball_bar"].reading["*"] == pytest.approx(late.astype(float))
    assert made["leg 2 latest"].joints[1].sum() == ((state.time >= 1800.0) & (state.time < 1800.0 + 80.0)).sum()
    assert made["leg 2 later"].joints[1].sum() == ((state.time >= 1800.0) & (state.time < 1800.0 + 40.0)).sum()


def test_frame_bending_is_the_same_seen_from_every_leg() -> None:
    """A tool point a lever out towards a leg, half a lever up: one unit of rr, half of rz, no tt."""
    state = small(session("a3_head").states[0], 3)
    lever, pose = state.machine.lever, np.zeros((3, 6))
    angle = -0.5 * np.pi + 2.0 * np.pi * np.arange(3) / 3.0
    pose[:, 0], pose[:, 1], pose[:, 2] = lever * np.cos(angle), lever * np.sin(angle), 1.166 + 0.5 * lever
    made = columns("frame_bending", dataclasses.replace(state, pose=pose))
    for i in range(3):
        for mode, wanted in (("rr", 1.0), ("tt", 0.0), ("rz", 0.5), ("zz", 0.25), ("rrr", 1.0), ("rrz", 0.5)):
            assert made[f"leg {i + 1} {mode}"].joints[i][i] == pytest.approx(wanted, abs=1e-9)
