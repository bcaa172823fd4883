"""Polished readings of a gantry and of a bar, against the oracles and differences."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import planar_geometry
from shipped_models import planar_2dof, pose_tracker

from kernel import a3_plans
from oed.instrument import mount
from oed.measurement import Measurement
from oed.poses import polish_readings
from oed.poses.polish import IPOPT_OPTIONS
from oed.poses.reading_plan import (
    ReadingPlan,
    find_fault,
    home_determinant,
    largest_hold_error,
    move_to_commands,
    restore_hold,
    symbolic_pose,
    tool_shift,
)

position = pose_tracker.position

PLANAR = Measurement(planar_2dof.machine, [mount(position, "tracker")])
COMMAND = np.array([[0.0, 0.5], [1.0, 0.4], [-0.8, 1.1], [0.4, 1.2], [-0.3, 0.1]])
READ = PLANAR.series("tracker", COMMAND)
BAR = a3_plans.measurement()
CIRCLES = a3_plans.circles(BAR, 6)


# -- slopes and poses ------------------------------------------------------------------
def test_equations_of_a_pose_hold_at_the_oracles_joints():
    pose = symbolic_pose(PLANAR.kinematics)
    for command in COMMAND:
        q = planar_geometry.inverse(command)
        zero = np.asarray(pose.residual(command, q, command, np.zeros(3)))
        assert zero == pytest.approx(0.0, abs=1e-9)
        off = np.asarray(pose.residual(command + 1e-3, q, command, np.zeros(3)))
        assert np.abs(off).max() > 1e-4


def test_the_determinant_is_that_of_the_struts_directions():
    """Rows of phi_x are unit vectors along the struts, over the lever squared."""
    pose, lever = symbolic_pose(PLANAR.kinematics), planar_2dof.machine.lever
    for command in COMMAND:
        q = planar_geometry.inverse(command)
        struts = command - planar_geometry.sliders(q, planar_geometry.NOMINAL)
        units = struts / np.linalg.norm(struts, axis=1)[:, None]
        exact = np.linalg.det(units) * lever**2
        assert float(pose.determinant(command, q)) == pytest.approx(exact)
    assert abs(home_determinant(PLANAR)) > 0.0


# -- plans -----------------------------------------------------------------------------
def test_readings_at_other_commands_have_the_oracles_joints():
    plan = move_to_commands(ReadingPlan(PLANAR, (READ,)), [COMMAND + 0.05])
    (series,) = plan.series
    assert series.q == pytest.approx(planar_geometry.inverse(COMMAND + 0.05), abs=1e-9)
    assert not plan.has_teach_pose(series)
    # y and z move with the tool's y and z
    assert tool_shift(PLANAR).tolist() == [[0, 1, 0], [0, 0, 1]]
    assert largest_hold_error(plan, None) == 0.0


def length_errors(plan: ReadingPlan) -> np.ndarray:
    """How far the oracle's bar is off its length at each reading."""
    (series,) = plan.series
    tips = a3.forward(np.zeros(24), series.q).tip
    pairs = tips[series.index[:, 0]] - tips[series.index[:, 1]]
    length = plan.setup(series).settings["length"]
    return np.abs(np.linalg.norm(pairs, axis=1) - length)


def test_a_moved_bar_comes_back_to_its_length():
    start = ReadingPlan(BAR, (CIRCLES,))
    assert start.has_teach_pose(CIRCLES)
    command = CIRCLES.command.copy()
    command[:-1, 2] += 1e-3
    moved = move_to_commands(start, [command])
    (series,) = moved.series
    assert series.command[-1] == pytest.approx(CIRCLES.command[-1])
    off = length_errors(moved).max()
    assert off > 1e-4
    assert largest_hold_error(moved, None) == pytest.approx(off, abs=1e-9)
    assert largest_hold_error(moved, 0.4 * off) == pytest.approx(0.6 * off, rel=1e-6)
    fault = find_fault(moved, {}, None, None)
    assert fault is not None
    assert "a held reading is off by" in fault
    restored = restore_hold(moved, None)
    assert length_errors(restored).max() < 1e-9
    assert find_fault(restored, {}, None, None) is None


def test_variables_beyond_their_range_are_a_fault():
    plan = ReadingPlan(BAR, (CIRCLES,))
    (name,) = BAR.setups
    fault = find_fault(plan, {name: {"length": (0.31, 0.32)}}, None, None)
    assert fault == f"length of set-up {name} leaves its range"
    far = a3_plans.circles(BAR, 6)
    command = far.command.copy()
    command[0, 0] += 10.0
    beyond = dataclasses.replace(far, command=command)
    assert find_fault(ReadingPlan(BAR, (beyond,)), {}, None, None) is not None


# -- polishing -------------------------------------------------------------------------
def log_det(measurement: Measurement, command: np.ndarray) -> float:
    """Of information and prior 1, from exact slopes of readings at commands."""
    series = measurement.series("tracker", command)
    rows = measurement.jacobian([series], measurement.nominal) * measurement.tolerance
    white = rows[:, measurement.free] / measurement.sigma([series])[:, None]
    return float(np.linalg.slogdet(white.T @ white + np.eye(white.shape[1]))[1])


def test_polished_readings_gain_and_no_small_move_gains_more():
    prior = np.eye(int(PLANAR.free.sum()))
    result = polish_readings(PLANAR, [READ], prior=prior)
    (series,) = result.series
    before, after = log_det(PLANAR, COMMAND), log_det(PLANAR, series.command)
    assert (result.value_before, result.value_after) == pytest.approx((before, after))
    assert after > before + 0.5
    y, z = planar_2dof.machine.command
    low, high = [y.lower, z.lower], [y.upper, z.upper]
    rng = np.random.default_rng(0)
    for _ in range(20):
        move = 1e-2 * rng.standard_normal(series.command.shape)
        moved = np.clip(series.command + move, low, high)
        assert log_det(PLANAR, moved) <= after + 1e-3


def test_a_file_of_the_current_folder_does_not_steer_the_solver(tmp_path, monkeypatch):
    """IPOPT reads `ipopt.opt` of that folder, unless it is told not to."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ipopt.opt").write_text("max_iter 0\n", encoding="utf-8")
    x = ca.SX.sym("x")
    options = {"ipopt": {**IPOPT_OPTIONS, "max_iter": 50}, "print_time": False}
    solver = ca.nlpsol("s", "ipopt", {"x": x, "f": (x - 1.0) ** 2}, options)
    assert float(solver(x0=0.0)["x"]) == pytest.approx(1.0)
