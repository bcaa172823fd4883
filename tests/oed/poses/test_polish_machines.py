"""Polished readings: rows by finite differences, gains, holds, ranges."""

import dataclasses
from collections.abc import Mapping

import casadi as ca
import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import planar_geometry
from shipped_models import ball_bar, planar_2dof, pose_tracker

from kernel import a3_plans
from kernel.cases import CASES, reading_series
from oed import identifiability
from oed.design import CRITERIA
from oed.instrument import mount
from oed.measurement import Measurement, Series
from oed.poses import polish, polish_readings, reading_plan
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

PAIRS = [
    ("a3_head", "ball_bar"), ("a3_head", "pose_tracker"),
    ("hexapod", "ball_bar_free_cup"), ("planar_2dof", "rm5"),
    ("linear_delta", "ball_bar"), ("cable_robot", "redundancy"),
    ("prs_spindle", "laser_ball_bar"),
]  # fmt: skip


@pytest.mark.parametrize(("machine", "setup"), PAIRS)
@pytest.mark.parametrize("scaling", ["si", "length", "tolerance"])
def test_rows_are_slopes_of_the_readings(machine, setup, scaling):
    """At random commands, against differences of the exact readings over each parameter."""
    m, series = reading_series(CASES[machine], setup, np.random.default_rng(4), 5)
    series = _away_from_home(m, series, setup, machine)
    mounted = m.setups[setup]
    if scaling == "tolerance" and any(c.shared for c in mounted.instrument.channels):
        with pytest.raises(ValueError, match="share an error"):
            reading_plan.symbolic_reading(
                m, mounted, scaling, np.eye(len(m.parameters))
            )
        return
    rows = _symbolic(m, series, scaling)
    step = 1e-6
    thetas = m.nominal + step * np.vstack(
        [np.eye(len(m.nominal)), -np.eye(len(m.nominal))]
    )
    y = m.readings([series], thetas)
    differences = (y[: len(m.nominal)] - y[len(m.nominal) :]).T / (2 * step)
    expected = differences * identifiability.column_scale(m, scaling)
    if scaling == "tolerance":
        expected = m.noise([series]).whiten(expected)
        # whitening is known up to a rotation of a reading's channels: products are not
        rows, expected = rows.T @ rows, expected.T @ expected
    elif scaling == "length":
        expected *= m.reading_length_factors([series])[:, None]
    assert rows == pytest.approx(expected, abs=2e-6 * np.abs(expected).max())


def _away_from_home(m: Measurement, series: Series, setup: str, machine: str) -> Series:
    """Not the upright pose, at which tilts have no second derivative; the same runs."""
    case = CASES[machine]
    n = len(series.q) - (m.setups[setup].teach is not None)
    command = case.commands(np.random.default_rng(5), n + 1)[1:]
    if m.setups[setup].teach is not None:
        command = np.vstack([command, series.command[-1:]])
    x, q = m.kinematics.inverse(command, None, np.array(m.setups[setup].tool))
    return dataclasses.replace(series, q=q, start=x, command=command)


def _symbolic(m, series, scaling):
    setup = m.setups[series.setup]
    one = reading_plan.symbolic_reading(m, setup, scaling, np.eye(len(m.parameters)))
    settings = np.array([setup.settings[s.name] for s in setup.instrument.settings])
    result = []
    for index in series.index:
        poses = [v for i in index for v in (series.start[i], series.q[i])]
        result.append(np.array(one.rows(*poses, settings, np.array(setup.tool))).T)
    return np.vstack(result)


# -- the A3 head with a ball bar -------------------------------------------------------
def _start(m: Measurement) -> Series:
    """18 readings on three circles, on hold."""
    stroke = np.repeat([0.03, 0.11, 0.19], 6)
    psi = np.concatenate(
        [2 * np.pi * np.arange(6) / 6 + shift for shift in (0.1, 0.5, 0.9)]
    )
    return m.series("cup", a3_plans.bar_commands(m, stroke, psi))


def _on_hold(result: polish.PolishResult, travel: float = 0.0) -> None:
    """Lengths from the geometry alone: ball to cup."""
    setup = result.setups[0]
    m, (series,) = result.measurement, result.series
    _, tip, _ = m.kinematics.frames(series.start, np.array(setup.tool))
    if setup.teach is not None:
        _, cup, _ = m.kinematics.frames(
            m.kinematics.inverse(np.array([setup.teach]))[0], np.array(setup.tool)
        )
        tip, cup = tip[:-1], cup[0]
    else:
        cup = np.array([setup.settings[f"at_{n}"] for n in "xyz"])
    off = np.linalg.norm(tip - cup, axis=1) - setup.settings["length"]
    assert np.abs(off).max() <= travel + 1e-9
    assert not m.machine.out_of_range(series.command[: len(series)], setup.tool)


def _check_values(result, start, before):
    """Values are those of the determinant over the 18 directions seen, formed anew."""
    rows = a3_plans.rows(before, [start])
    basis = np.linalg.svd(rows)[2][:18].T
    after = a3_plans.rows(result.measurement, result.series) @ basis
    assert result.value_before == pytest.approx(
        np.linalg.slogdet((rows @ basis).T @ (rows @ basis))[1], abs=1e-5
    )
    assert result.value_after == pytest.approx(
        np.linalg.slogdet(after.T @ after)[1], abs=1e-5
    )


FREE: dict[str, tuple[bool, Mapping[str, tuple[float, float]]]] = {
    "taught, length": (True, {"length": (0.28, 0.32)}),
    "free cup, tool": (False, {"tool_z": (-0.02, 0.05)}),
}


@pytest.mark.parametrize("case", FREE)
def test_polished_bar_stays_on_hold(case):
    taught, ranges = FREE[case]
    m = a3_plans.measurement(taught=taught)
    start = _start(m)
    if (
        "tool" in case
    ):  # a tool changes what is seen: a prior makes all directions count
        result = polish.polish_readings(
            m, [start], free={"cup": ranges}, prior=np.eye(int(m.free.sum()))
        )
    else:
        result = polish.polish_readings(
            m, [start], scaling="length", free={"cup": ranges}
        )
        _check_values(result, start, m)
    assert result.value_after > result.value_before + 0.1
    assert result.summary.startswith("polishing gained")
    _on_hold(result)
    setup = result.setups[0]
    for name, (lower, upper) in ranges.items():
        value = setup.tool[2] if name == "tool_z" else setup.settings[name]
        assert lower <= value <= upper
    settings = m.setups["cup"].settings
    assert (setup.settings != settings) == ("length" in ranges)
    assert taught == (setup.teach is not None)
    if taught:
        assert result.series[0].command[-1] == pytest.approx(setup.teach, abs=0)
    assert setup.teach == m.setups["cup"].teach


def test_travel_gives_room():
    m = a3_plans.measurement()
    start = _start(m)
    exact = polish.polish_readings(m, [start], scaling="length", iterations=150)
    roomy = polish.polish_readings(
        m, [start], scaling="length", travel=1e-3, iterations=150
    )
    _on_hold(roomy, 1e-3)
    assert roomy.value_after > exact.value_after


def test_a_search_cut_short_is_never_worse():
    m = a3_plans.measurement()
    none = polish.polish_readings(m, [_start(m)], scaling="length", iterations=0)
    assert none.value_after >= none.value_before
    if none.value_after == none.value_before:
        assert "the start is kept" in none.summary


# -- other machines --------------------------------------------------------------------
def test_planar_with_a_tracker():
    criterion = CRITERIA.build("Ds", 13, np.eye(13)[:, :7])
    machine = CASES["planar_2dof"].machine
    m = Measurement(machine, [mount(pose_tracker.position, "tracker")])
    command = CASES["planar_2dof"].commands(np.random.default_rng(1), 8)
    n = int(m.free.sum())
    result = polish.polish_readings(
        m, [m.series("tracker", command)], criterion, prior=np.eye(n), clearance=0.2
    )
    assert result.value_after > result.value_before
    rows = identifiability.scaled(m, result.series, m.nominal, "tolerance")[:, m.free]
    assert result.value_after == pytest.approx(
        criterion.log_size * criterion.value(np.eye(n) + rows.T @ rows), abs=1e-9
    )
    assert not machine.out_of_range(result.series[0].command)


def test_impossible_requests_are_refused():
    m = a3_plans.measurement()
    start = _start(m)
    off = m.series("cup", start.command[:-1] + np.array([1e-4, 0.0, 0.0]))
    for given, message in (
        ({"free": {"cap": {"length": (0.2, 0.3)}}}, "has no readings"),
        ({"free": {"cup": {"height": (0.2, 0.3)}}}, "none of"),
        ({"free": {"cup": {"length": (0.1, 0.2)}}}, "outside"),
    ):
        with pytest.raises(ValueError, match=message):
            polish.polish_readings(m, [start], scaling="length", **given)
    with pytest.raises(ValueError, match="off the value that its instrument holds"):
        polish.polish_readings(m, [off], scaling="length")
    with pytest.raises(ValueError, match="recorded"):
        polish.polish_readings(
            m, [m.series_from_joints("cup", start.q[:-1])], scaling="length"
        )


def test_two_setups_share_nothing_but_the_machine():
    setups = [
        mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0)),
        mount(pose_tracker.position, "tracker"),
    ]
    m = Measurement(CASES["a3_head"].machine, setups)
    bar = _start(m)
    index = m.series(
        "tracker", CASES["a3_head"].commands(np.random.default_rng(0), 5)[1:]
    )
    result = polish.polish_readings(m, [bar, index], prior=np.eye(int(m.free.sum())))
    assert result.value_after > result.value_before
    assert [len(s) for s in result.series] == [18, 4]
    _on_hold(dataclasses.replace(result, series=result.series[:1]))


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
