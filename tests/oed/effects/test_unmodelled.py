"""What effects do in the states of use and outside the model, on the oracles."""

import itertools
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from oracles import a3_geometry as a3
from shipped_models import (
    encoder_scale,
    gravity,
    hexapod,
    leg_thermal,
    pose_tracker,
    servo_lag,
    step,
)

from kernel import a3_plans
from kernel.a3_machines import NOISE, PER_KELVIN, WARM_LEG, planned
from oed import Measurement, compensate, mount
from oed.accuracy import BudgetModel, ErrorMaps, Prediction, driven_errors
from oed.effect_model import Column, Effect, State
from oed.effects import ExpectedColumns, ExpectedEffects, SessionStates
from oed.effects.unmodelled import _joint_maps
from oed.estimation import identify
from oed.gap import DOWN, GapProblem, assemble
from oed.mechanism import NO_TOOL


def expected_of(effects, command, reference="home"):
    """What effects do to the plan of the warm head, at commands of its workspace."""
    m = a3_plans.measurement()
    series, rows = planned(m)
    problem = assemble(m, (series,), rows)
    states = SessionStates(m, rows, problem.states, DOWN)
    budget = BudgetModel.of(m, problem.series, m.nominal)
    maps, rng = ErrorMaps.of(m.kinematics, command, reference), np.random.default_rng(3)
    return ExpectedEffects.of(problem, states, budget, maps, effects, reference, rng)


def test_a_warm_leg_errs_as_expected_where_calibration_takes_it_for_geometry():
    """A nominal head whose leg 2 grows by 11.5 ppm a kelvin: no noise, no statistics."""
    m = a3_plans.measurement()
    series, rows = planned(m)
    problem = assemble(m, (series,), rows)
    command = a3_plans.workspace()[::9]
    maps = ErrorMaps.of(m.kinematics, command, "absolute")
    session = SessionStates(m, rows, problem.states, DOWN)
    # no feed is stated
    first = expected_of([leg_thermal.effect, servo_lag.effect], command, "absolute")
    (expected,) = first.effects
    assert expected.not_testable is None
    assert set(expected.sizes["leg 2 per kelvin"]) == {PER_KELVIN}
    q = series.q[series.index[:, 0]].copy()
    q[:, WARM_LEG] *= 1.0 + PER_KELVIN * rows["temp_leg2"].to_numpy()
    cup = a3.forward(np.zeros(24), series.q[series.index[:1, 1]]).tip
    believed = identify(m, [series], a3.ball_bar_reading(np.zeros(24), q, cup)).theta
    drawn = np.random.default_rng(3)
    state = session.workspace_state(m.nominal, command, drawn)
    joints = compensate.compensated_joints(m.kinematics, command, believed[:24])
    warm = state.temperature["leg2"][:-1]
    joints[:, WARM_LEG] *= 1.0 + PER_KELVIN * warm
    z = a3.forward(np.zeros(24), joints).tip[:, 2] - command[:, 0]
    wanted = np.sqrt(expected.variance[:, maps.names.index("z")])
    assert np.abs(z) == pytest.approx(wanted, rel=0.05, abs=0.02 * wanted.max())
    assert np.sqrt(np.mean(z**2)) > 1e-6
    smaller = leg_thermal.effect.with_expected_size("1/K", PER_KELVIN / 4.0)
    second = expected_of([smaller], command, "absolute")
    (quarter,) = second.effects
    assert quarter.sizes["leg 2 per kelvin"][0] == pytest.approx(PER_KELVIN / 4.0)
    assert 16.0 * quarter.variance == pytest.approx(expected.variance, rel=1e-9)


def test_a_warm_leg_that_is_fitted_and_corrected_leaves_what_the_posterior_leaves():
    """Dense matrices; the leg's columns are differences of the oracle's head."""
    m = a3_plans.measurement()
    series, rows = planned(m)
    problem = assemble(m, (series,), rows)
    command = a3_plans.workspace()[::17]
    maps = ErrorMaps.of(m.kinematics, command, "absolute")
    session = SessionStates(m, rows, problem.states, DOWN)
    all_of_it = expected_of([leg_thermal.effect], command, "absolute")
    q = series.q[series.index[:, 0]].copy()
    cup = a3.forward(np.zeros(24), series.q[series.index[:1, 1]]).tip
    cold = a3.ball_bar_reading(np.zeros(24), q, cup)
    q[:, WARM_LEG] *= 1.0 + PER_KELVIN * rows["temp_leg2"].to_numpy()
    change = a3.ball_bar_reading(np.zeros(24), q, cup) - cold
    state = session.workspace_state(m.nominal, command, np.random.default_rng(3))
    nominal = np.zeros(24)
    joints = compensate.compensated_joints(m.kinematics, command, nominal)
    joints[:, WARM_LEG] *= 1.0 + PER_KELVIN * state.temperature["leg2"][:-1]
    moved = a3.forward(nominal, joints).tip[:, 2] - command[:, 0]
    h = np.column_stack([m.jacobian([series], m.nominal) * m.tolerance, change])
    covariance = np.linalg.inv(np.eye(h.shape[1]) + h.T @ h / NOISE**2)
    z = maps.names.index("z")
    by_parameter = np.zeros((len(command), len(m.names)))
    by_parameter[:, :24] = maps.raw[:, z]
    unit = np.column_stack([by_parameter * m.tolerance, moved])
    wanted = np.einsum("ni,ij,nj->n", unit, covariance, unit)
    corrected = all_of_it.prediction.fully_corrected["z"].rms ** 2
    assert corrected == pytest.approx(wanted.mean(), rel=0.02)
    parameters = covariance_of_parameters(h[:, :-1])
    geometry = np.einsum("ni,ij,nj->n", unit[:, :-1], parameters, unit[:, :-1])
    assert np.all(geometry <= wanted * (1.0 + 1e-6))
    assert corrected <= np.mean(geometry + all_of_it.added[:, z])
    # parameters alone: what is known of the effect stays, but for what they take up
    sent = all_of_it.prediction.after["z"].rms ** 2
    known = 1.0 - covariance[-1, -1]
    assert corrected < sent <= (wanted + known * moved**2).mean() * 1.02
    # without the only effect, geometry stays alone
    (leg,) = all_of_it.effects
    assert leg.without[:, z] == pytest.approx(geometry, rel=0.02)


def test_an_effect_that_is_a_parameter_costs_nothing_where_parameters_are_sent():
    """A leg that is too long is its zero offset; what no parameter is stays whole."""

    def of(change: Callable[[State], np.ndarray]) -> Prediction:
        """The accuracy where leg 1 errs by a change (m,), unit size 1 mm."""
        effect = Effect(
            name="made",
            source="",
            about="",
            columns=lambda state: [Column("leg 1", 1e-3, joints={0: change(state)})],
        )
        expected = expected_of([effect], a3_plans.workspace()[::17], "absolute")
        return expected.prediction

    offset = of(lambda state: np.ones(len(state)))
    assert offset.after["z"].rms == pytest.approx(
        offset.fully_corrected["z"].rms, rel=1e-3
    )
    ripple = of(lambda state: np.sin(state.joints[:, 0] / 1e-5))
    added = ripple.after["z"].rms ** 2 - ripple.fully_corrected["z"].rms ** 2
    assert added > 30e-6**2


def test_an_incident_is_looked_for_but_not_counted_on():
    assert step.effect.incident
    assert expected_of([step.effect], a3_plans.workspace()[::30]) is None


def covariance_of_parameters(h: np.ndarray) -> np.ndarray:
    """Posterior covariance without any effect, in units of the tolerances."""
    return np.linalg.inv(np.eye(h.shape[1]) + h.T @ h / NOISE**2)


def test_an_effect_acts_in_the_states_of_use():
    """Twice as warm as stated for half the poses, cold for the others; the rest as before."""
    m = a3_plans.measurement()
    series, rows = planned(m)
    problem = assemble(m, (series,), rows)
    command = a3_plans.workspace()[::3]
    session = SessionStates.of(problem)
    used = SessionStates.of(problem, {"temp_leg2": np.array([0.0, 20.0])})

    def states(of: SessionStates) -> State:
        return of.workspace_state(m.nominal, command, np.random.default_rng(3))

    before, after = states(session), states(used)
    start = before.start_temperature["leg2"]
    at = after.temperature["leg2"][:-1]
    assert set(at) <= {0.0, 20.0}
    assert 0.2 < np.mean(at > 0.0) < 0.8
    assert after.temperature["leg2"][-1] == before.temperature["leg2"][-1]
    np.testing.assert_array_equal(after.joints, before.joints)
    columns = leg_thermal.effect.columns(after, tau=1800.0)
    column = next(c for c in columns if c.name == "leg 2 per kelvin")
    growth = column.joints[WARM_LEG][:-1]
    assert growth == pytest.approx(after.joints[:-1, WARM_LEG] * (at - start))


def test_effects_that_need_what_no_plan_states_are_left_out():
    expected = expected_of(
        [gravity.effect, servo_lag.effect], a3_plans.workspace()[::30]
    )
    assert [e.effect.name for e in expected.effects] == ["gravity"]


def test_nothing_is_expected_of_effects_that_need_what_no_plan_states():
    """One machine's only effect depends on the feed, which the rows do not have."""
    assert expected_of([servo_lag.effect], a3_plans.workspace()[::30]) is None


def test_compensation_takes_away_what_the_parameters_mimic(rng):
    """All of an effect that is an error of parameters; nothing where nothing is sent."""
    raw = rng.standard_normal((5, 3, 4))
    shift = rng.standard_normal((4, 2))
    model = SimpleNamespace(root=np.eye(4), used=np.arange(4))
    tool = raw @ shift
    for remaining, left in ((np.zeros_like(raw), 0.0 * tool), (raw, tool)):
        maps = ErrorMaps(np.zeros((5, 3)), ("x", "y", "z"), raw, remaining)
        joint = _joint_maps(model, maps, tool, shift)
        assert joint.remaining[:, :, 4:] == pytest.approx(left, abs=1e-12)
        assert joint.raw[:, :, 4:] == pytest.approx(tool)


position = pose_tracker.position
ABOVE = hexapod.ABOVE
HEIGHT = hexapod.HEIGHT
PLATFORM = hexapod.PLATFORM
machine = hexapod.machine

FEED = 0.025
NESTS = {"one": (0.15, 0.0, 0.03), "two": (-0.08, 0.13, 0.03)}
TILTS = np.deg2rad([-4.0, 4.0])  #: neighbours differ by 30 mm or by 8 degrees alone
PLACES = itertools.product((-0.015, 0.015), TILTS, TILTS)
COMMAND = np.array([[x, 0.0, HEIGHT, rx, ry, 0.0] for x, rx, ry in PLACES])


def session(names: tuple[str, ...], feed: float = FEED) -> GapProblem:
    """Readings of nests beside the axis, in this order of the set-ups."""
    setups = [mount(position, name, tool=NESTS[name]) for name in names]
    m = Measurement(machine, setups)
    rng = np.random.default_rng(7)
    spread = np.array([0.03, 0.03, 0.03, 0.06, 0.06, 0.06])
    series = []
    for name in names:
        offset = spread * rng.uniform(-1.0, 1.0, (12, 6))
        tool = np.array(NESTS[name])
        command = machine.with_tool(machine.home_command + offset, tool)
        series.append(m.series(name, command))
    setups, order = np.repeat(names, 12), [*range(12)] * len(names)
    rows = pd.DataFrame({"setup": setups, "run": "1", "order": order, "feed": feed})
    return assemble(m, tuple(series), rows)


def in_use(problem: GapProblem, used: dict[str, np.ndarray] | None = None):
    of = SessionStates.of(problem, used)
    return of.workspace_state(problem.theta, COMMAND, np.random.default_rng(1))


@pytest.mark.parametrize("names", [("one", "two"), ("two", "one")])
def test_a_command_has_the_reference_tool_whatever_the_setups_have(names):
    """The tool point is at the x, y, z commanded; effects move it as the joints say."""
    problem = session(names)
    state = in_use(problem)
    np.testing.assert_allclose(state.tool[:-1], COMMAND[:, :3], atol=1e-9)
    columns = ExpectedColumns.of(problem, [encoder_scale.effect], unknown=False)
    p, rng = problem, np.random.default_rng(1)
    states = SessionStates(p.measurement, p.covariates, p.states, DOWN)
    maps = columns.workspace_maps(states, p.theta, COMMAND, "absolute", rng)
    m = problem.measurement
    pose, joints = m.kinematics.inverse(COMMAND)
    (form,) = columns.forms
    changes = {c.name: c for c in form.effect.columns(state)}
    weights = dict(zip(form.names, columns.mixing[:, 0], strict=True))
    for name, weight in weights.items():
        for joint, change in changes[name].joints.items():
            joints[:, joint] += weight * changes[name].scale * change[:-1]
    moved = m.kinematics.forward(joints, machine.nominal, pose)
    tip = m.kinematics.frames(moved, NO_TOOL)[1]
    assert np.abs(maps.raw[:, :3, 0]).max() > 1e-6
    np.testing.assert_allclose(maps.raw[:, :3, 0], tip - COMMAND[:, :3], atol=1e-8)


def test_a_longer_tool_is_zeroed_at_home_with_that_tool():
    """At home nothing is left of any error, whatever the tool."""
    tool = np.array([0.0, 0.0, -0.12])
    kinematics = session(("one",)).measurement.kinematics
    home = machine.with_tool(machine.home_command[None], tool)
    truth = machine.nominal + 1e-3 * np.random.default_rng(2).standard_normal(42)
    nominal = machine.nominal
    errors = driven_errors(kinematics, home, truth, "home", believed=nominal, tool=tool)
    assert np.abs(errors).max() < 1e-12


def test_legs_are_no_faster_than_their_platform_joints():
    """A joint at r of the tool point goes at most at (1 + r / lever) times the feed."""
    problem = session(("one", "two"))
    state = in_use(problem, {"feed": np.array([FEED])})
    reach = np.hypot(PLATFORM, ABOVE)
    rate = np.abs(state.rate)
    assert 0.1 * FEED < rate.max() <= FEED * (1.0 + reach / machine.lever)


def test_joints_go_no_faster_than_recorded_unless_a_feed_in_use_says_so():
    problem = session(("one", "two"), feed=1e-3)
    state = in_use(problem)
    for name in ("rate", "acceleration"):
        recorded = max(np.abs(getattr(s, name)).max() for s in problem.states)
        assert 0.0 < np.abs(getattr(state, name)).max() <= recorded * (1.0 + 1e-12)
    faster = in_use(problem, {"feed": np.array([FEED])})
    ratio = np.abs(faster.rate[:-1]).max(axis=1) / np.abs(state.rate[:-1]).max(axis=1)
    assert ratio.min() >= FEED / 1e-3 * (1.0 - 1e-9)


def test_the_joints_are_those_that_hold_the_command_on_the_identified_machine():
    """A leg 5 mm longer: its joint differs by some 5 mm, and the tool stays in place."""
    problem = session(("one",))
    theta = problem.theta.copy()
    (leg,) = [k for k, p in enumerate(machine.parameters) if p.name == "dl1"]
    theta[leg] += 5e-3
    of = SessionStates.of(problem)
    moved = of.workspace_state(theta, COMMAND, np.random.default_rng(1))
    nominal = in_use(problem)
    np.testing.assert_allclose(moved.tool, nominal.tool, atol=1e-9)
    change = np.abs(moved.joints - nominal.joints)
    assert change[:, 0].min() > 4e-3
    assert change[:, 1:].max() < 1e-9


def test_joints_arrive_from_both_sides_over_a_grid():
    """Along its rows they would arrive from one side: a shift that a reference takes."""
    problem = session(("one",))
    grid = np.linspace(-0.03, 0.03, 8)
    rows = itertools.product(grid, grid)
    command = np.array([[x, y, HEIGHT, 0.0, 0.0, 0.0] for x, y in rows])
    of = SessionStates.of(problem)
    state = of.workspace_state(problem.theta, command, np.random.default_rng(1))
    np.testing.assert_allclose(state.tool[:-1], command[:, :3], atol=1e-9)
    assert np.abs(state.motion_sign[:-1].mean(axis=0)).max() < 0.4
    by_row = state.motion_sign[:-1].reshape(8, 8, -1)
    assert (by_row.min(axis=1) < by_row.max(axis=1)).mean() > 0.9
