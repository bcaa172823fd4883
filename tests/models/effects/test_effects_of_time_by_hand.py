"""As `test_effects_by_hand`, for what changes with time: heat, drifts, steps; and the
bar's length.
"""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from effects_sample import HOURS, ROUND, columns, effect_of, session, small

from oed.gap import GapProblem, exact_readings, states
from pkm_models.effects import terms


def test_leg_thermal_by_hand():
    """0.6 m of steel, 2 K: 13.8 um; without a sensor 63.2 % of the final rise after one
    time constant.
    """
    state = session("hexapod").states[0]
    known = {"strut_length": np.full((2, 6), 0.6), "joint_per_length": np.ones((2, 6))}
    warm = columns(
        "leg_thermal",
        small(state, 2, temperature={"leg": np.array([21.0, 23.0])}, **known),
    )["leg 3 per kelvin"]
    assert warm.scale * warm.joints[2] == pytest.approx([0.0, 13.8e-6])
    timed = small(
        state,
        2,
        time=np.array([0.0, 3600.0]),
        session_times=np.linspace(0.0, 3600.0, 61),
        **known,
    )
    rise = columns("leg_thermal", timed, tau=3600.0)["leg 3 rise"]
    assert rise.joints[2] == pytest.approx([0.0, 11.5e-6 * 0.6 * (1.0 - np.exp(-1.0))])
    own = small(state, 2, temperature={"leg3": np.array([0.0, 1.0])}, **known)
    assert columns("leg_thermal", own)["leg 3 per kelvin"].joints[2] == pytest.approx(
        [0.0, 0.6]
    )


def test_leg_thermal_of_a_carriage_is_its_screw():
    """A screw 2 K warmer at 0.25 m from its bearing: 5.75 um; the rod that the carriage
    moves is not driven.
    """
    state = session("linear_delta").states[0]
    warm = small(
        state,
        2,
        joints=np.full((2, 3), 0.25),
        temperature={"leg": np.array([21.0, 23.0])},
    )
    made = columns("leg_thermal", warm)
    assert made["leg 2 per kelvin"].scale * made["leg 2 per kelvin"].joints[
        1
    ] == pytest.approx([0.0, 5.75e-6])
    rod = made["leg 2 per kelvin strut"]
    assert rod.shape
    assert rod.joints[1] == pytest.approx(
        2.0
        * state.strut_length[:2, 1]
        * state.joint_per_length[:2, 1]
        * np.array([0.0, 1.0])
    )


def test_leg_thermal_of_a_turning_arm_is_its_rod():
    """An angle does not grow: where joints turn arms, the struts that they move are what warms."""
    state = session("linear_delta").states[0]
    turning = [dataclasses.replace(c, unit="rad") for c in state.machine.joints]
    machine = dataclasses.replace(state.machine, joints=tuple(turning))
    warm = small(state, 2, machine=machine, temperature={"leg": np.array([21.0, 23.0])})
    made = columns("leg_thermal", warm)
    assert "leg 2 per kelvin strut" not in made
    grown = (
        2.0
        * state.strut_length[:2, 1]
        * state.joint_per_length[:2, 1]
        * np.array([0.0, 1.0])
    )
    assert made["leg 2 per kelvin"].joints[1] == pytest.approx(grown)


def test_what_warms_at_work_cools_in_breaks():
    """Ten runs of ten minutes, a break of two hours, and ten more: cooled by exp(-7200
    / tau) over the break.
    """
    state = session("hexapod").states[0]
    first = np.concatenate([600.0 * k + np.arange(0.0, 301.0, 10.0) for k in range(10)])
    both = np.concatenate([first, first + first[-1] + 7200.0])
    before, after = float(first[-1]), float(first[-1] + 7200.0)
    timed = small(state, 2, time=np.array([before, after]), session_times=both)
    share = terms.warm_up(timed, "leg", 5400.0)[1]
    assert share[0] == pytest.approx(1.0 - np.exp(-before / 5400.0))
    assert share[1] == pytest.approx(share[0] * np.exp(-7200.0 / 5400.0))


def test_a_body_lags_behind_its_sensor():
    """Behind a ramp of slope a from rest, a body of time constant T is a T (1 - exp(-t
    / T)) behind.
    """
    state, time = session("hexapod").states[0], np.linspace(0.0, 7200.0, 10)
    ramp = small(state, 10, time=time, temperature={"leg": 1e-3 * time})
    measured, rise, behind = terms.warm_up(ramp, "leg", 1800.0)
    assert measured
    assert rise == pytest.approx(1e-3 * time)
    assert behind == pytest.approx(-1.8 * (1.0 - np.exp(-time / 1800.0)))


@pytest.mark.parametrize("machine", ["planar_2dof", "a3_head", "prs_spindle"])
def test_frame_thermal_is_the_base_joints_moving_apart(machine):
    """As the machine's own parameters of its base joints would have it."""
    s = session(machine)
    m, state, response = s.measurement, s.states[1], s.responses[1]
    (column,) = [
        c for c in columns("frame_thermal", state, tau=3600.0).values() if not c.shape
    ]
    found = sum(
        response.joints[0][:, :, i] * v[:, None] for i, v in column.joints.items()
    )
    growth = 11.5e-6 * -np.expm1(-state.time / 3600.0)
    if machine == "planar_2dof":
        wanted = (
            response.parameters[0][:, :, m.machine.index("D")]
            * (3.584 * growth)[:, None]
        )
    else:
        stem, radius, turn = (
            ("db", 0.250, -0.5 * np.pi) if machine == "a3_head" else ("dR", 0.349, 0.0)
        )
        wanted = np.zeros_like(found)
        for i in range(3):
            angle = turn + 2.0 * np.pi * i / 3.0
            for k, part in (("x", np.cos(angle)), ("y", np.sin(angle))):
                slope = response.parameters[0][
                    :, :, m.machine.index(f"{stem}{i + 1}{k}")
                ]
                wanted += slope * (radius * part * growth)[:, None]
    assert found == pytest.approx(wanted, abs=1e-6 * np.abs(wanted).max())


def test_bar_length_is_a_constant_of_bars_alone():
    s = session("a3_head")
    found = GapProblem.signature(s, effect_of("bar_length"), {})
    bar = 2 * ROUND
    assert found.names == ("bar 300 mm",)
    assert found.columns[:bar, 0] == pytest.approx(np.full(bar, 10e-6))
    assert not found.columns[bar:].any()


def test_bar_thermal_by_hand():
    """A bar of 0.3 m, 2 K warmer, is 6.9 um longer and reads that much less."""
    state = small(
        session("a3_head").states[0], 2, temperature={"bar": np.array([20.0, 22.0])}
    )
    (column,) = [
        c for c in columns("bar_thermal", state, held=0.0).values() if not c.shape
    ]
    assert column.scale * column.reading["length"] == pytest.approx([0.0, -6.9e-6])


def test_bar_that_was_held_is_warm_at_the_start_of_each_setup():
    """0.3 m of steel, 1 K from the hand: 3.45 um, 1.27 um of it left after a time
    constant, of 7200 s / 4.
    """
    state = small(session("a3_head").states[0], 2, time=np.array([5000.0, 6800.0]))
    (column,) = [
        c
        for c in columns("bar_thermal", state, tau=7200.0, held=1.0).values()
        if not c.shape
    ]
    assert column.scale * column.reading["length"] == pytest.approx(
        [-3.45e-6, -3.45e-6 * np.exp(-1.0)]
    )


def test_mount_drift_is_a_cup_elsewhere_at_the_end():
    s = session("a3_head")
    m, theta = s.measurement, s.measurement.nominal
    name = "set-up ball_bar cup_x"
    drifted = exact_readings(
        m, s.series, theta, s.states, [(effect_of("mount_drift"), {}, {name: 1.0})]
    )
    away = theta.copy()
    away[m.names.index("ball_bar.cup_x")] = 5e-6
    start, moved = m.readings(s.series, theta), m.readings(s.series, away)
    share = s.states[0].time[: 2 * ROUND] / HOURS
    # a circle is not a line
    assert (drifted - start)[: 2 * ROUND] == pytest.approx(
        share * (moved - start)[: 2 * ROUND], abs=2e-11
    )
    assert drifted[2 * ROUND :] == pytest.approx(start[2 * ROUND :], abs=1e-15)


def test_free_courses_are_a_smooth_random_course_that_starts_at_nothing():
    """Matern's correlation k of 3/2, less the start: k(s, t) - k(s, 0) - k(0, t) + 1;
    four modes have four fifths of it.
    """
    state = session("planar_2dof").states[0]
    time = np.linspace(0.0, HOURS, len(state))
    courses = np.column_stack(
        list(terms.free_courses(dataclasses.replace(state, time=time)).values())
    )
    assert courses[0] == pytest.approx(np.zeros(terms.N_COURSES), abs=1e-2)
    at = 2.0 * time / HOURS - 1.0
    far = np.sqrt(3.0) / terms.COURSE_LENGTH * np.abs(at[:, None] - at)
    correlation = (1.0 + far) * np.exp(-far)
    wanted = correlation - correlation[:1] - correlation[:, :1] + 1.0
    share = (courses**2).sum() / np.trace(wanted)
    assert share == pytest.approx(0.8, abs=0.05)
    error = np.abs(courses @ courses.T - wanted).max()
    assert error < 0.5


def test_mount_drift_of_a_laser_without_unknowns_is_in_its_readings():
    state = session("planar_2dof").states[0]
    made = columns("mount_drift", dataclasses.replace(state, setup="rm1"))
    assert made["set-up rm1 dy"].reading["dy"] == pytest.approx(state.time / HOURS)


@pytest.mark.parametrize(("when", "lasts", "first", "last"), [
    (0.25, 9.0, 1800.0, np.inf), (0.25, 0.27, 1800.0, 3744.0), (0.75, -0.37, 2736.0, 5400.0),
    (0.25, -0.5, -np.inf, 1800.0),
])  # fmt: skip
def test_step_is_there_in_its_window(when, lasts, first, last):
    """In a session of two hours; what adapts lets it begin 40 s or 80 s later, where it
    begins in the session.
    """
    state = session("planar_2dof").states[0]
    assert state.session_span == (0.0, HOURS)
    time = np.concatenate(
        [
            np.linspace(0.0, HOURS, len(state) - 6),
            first + np.array([-1, 1, 39, 41, 79, 81]),
        ]
    )
    state = dataclasses.replace(state, time=np.where(np.isfinite(time), time, 0.0))
    made = columns("step", state, when=when, lasts=lasts)
    inside = (state.time >= first) & (state.time < last)
    assert 0 < inside.sum() < len(state)
    for leg in (0, 1):
        there = made[f"leg {leg + 1}"]
        assert there.joints == {leg: pytest.approx(inside.astype(float))}
        assert there.scale * there.joints[leg] == pytest.approx(20e-6 * inside)
        for name, late in (("later", 40.0), ("latest", 80.0)):
            behind = there.joints[leg] - made[f"leg {leg + 1} {name}"].joints[leg]
            assert behind == pytest.approx(
                (inside & (state.time >= first + late)).astype(float)
            )


def test_step_of_a_mount_is_a_cup_or_a_camera_elsewhere_meanwhile():
    s = session("a3_head")
    m, theta, effect = s.measurement, s.measurement.nominal, effect_of("step")
    start = m.readings(s.series, theta)
    time = np.concatenate(
        [
            state.time[series.index[:, 0]]
            for state, series in zip(s.states, s.series, strict=True)
        ]
    )
    # one length, three coordinates
    time = np.repeat(time, [1] * 2 * ROUND + [3] * 2 * ROUND)
    meanwhile = (time >= 0.25 * HOURS) & (time < 0.75 * HOURS)
    bar = np.arange(len(time)) < 2 * ROUND
    for name, unknown, size, mine in (
        ("set-up ball_bar cup_x", "ball_bar.cup_x", 10e-6, bar),
        ("set-up camera shift_z", "camera.shift_z", 10e-6, ~bar),
        ("set-up camera turn_y", "camera.turn_y", 20e-6, ~bar),
    ):
        away = theta.copy()
        away[m.names.index(unknown)] += size
        moved = m.readings(s.series, away)
        assert np.abs(moved - start)[mine & meanwhile].max() > 1e-6
        knocked = exact_readings(
            m,
            s.series,
            theta,
            s.states,
            [(effect, {"when": 0.25, "lasts": 0.5}, {name: 1.0})],
        )
        assert knocked == pytest.approx(np.where(meanwhile, moved, start), abs=1e-12)


def test_step_of_a_laser_without_unknowns_is_in_its_readings():
    state = dataclasses.replace(session("planar_2dof").states[0], setup="rm1")
    column = columns("step", state, when=0.25)["set-up rm1 dy"]
    assert column.scale * column.reading["dy"] == pytest.approx(
        10e-6 * (state.time >= 1800.0)
    )
    assert not column.joints


def test_progress_is_by_the_clock_or_by_the_order_of_the_readings():
    """Two set-ups of 48 readings, the second with twice the time between them; a clock
    that is told in part is none.
    """
    s = session("planar_2dof")
    rows = 4 * ROUND
    time = np.cumsum(np.repeat([10.0, 20.0], rows // 2))
    covariates = pd.DataFrame(
        {"order": np.tile(np.arange(1, ROUND + 1), 4), "time": time}
    )
    lost = covariates.assign(time=np.where(np.arange(rows) == 5, np.nan, time))
    told = {"clock": covariates, "order": covariates.drop(columns="time"), "part": lost}
    gone = {}
    for name, frame in told.items():
        made = states(s.measurement, s.series, frame, s.measurement.nominal)
        gone[name] = np.concatenate(
            [
                m.session_progress[k.index[:, 0]]
                for m, k in zip(made, s.series, strict=True)
            ]
        )
    assert gone["clock"] == pytest.approx((time - time[0]) / (time[-1] - time[0]))
    assert gone["order"] == pytest.approx(np.arange(rows) / (rows - 1.0))
    assert gone["part"] == pytest.approx(gone["order"])
