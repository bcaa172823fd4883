"""States of use: one tool for a command, no motion beyond what was recorded."""

import itertools

import numpy as np
import pandas as pd
import pytest
from shipped_models import encoder_scale, hexapod, pose_tracker

from oed import Measurement, mount
from oed.accuracy import driven_errors
from oed.effects import ExpectedColumns, SessionStates
from oed.gap import DOWN, GapProblem, assemble
from oed.mechanism import NO_TOOL

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
