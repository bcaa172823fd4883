"""Readings at other poses, joints at a stop and orders of rows, against the oracle."""

import dataclasses
import itertools
from types import SimpleNamespace

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest
from oracles import a3_geometry as a3
from shipped_models import a3_head

from kernel import a3_machines, a3_plans
from kernel.a3_machines import turned
from oed import checks
from oed.checks.mistakes import Suspect
from oed.checks.mistakes.joints import _likely_stops, likely_orders
from oed.checks.mistakes.moved import (
    change_column,
    commanded,
    commanded_in_file,
    inside,
    jointed,
    moved_rows,
    moved_trials,
    permuted,
    pose_table,
    readings_by_run,
    shifted,
    turns_freely,
    wrapped,
)
from oed.checks.sentences import contradictions
from oed.checks.session import SessionReadings
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError

MACHINE = a3_head.machine


@pytest.fixture(scope="module")
def session() -> SessionReadings:
    return machines.session("a3", machines.readings("a3", 2))


def test_columns_are_changed_shifted_and_permuted():
    values = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert change_column(1, lambda v: 10.0 * v)(values).tolist() == [
        [1, 20, 3],
        [4, 50, 6],
    ]
    assert shifted(2, -1.0)(values).tolist() == [[1, 2, 2], [4, 5, 5]]
    assert permuted((2, 0, 1))(values).tolist() == [[3, 1, 2], [6, 4, 5]]
    turned = permuted((1, 0, 2), (1.0, -1.0, 1.0))
    assert turned(values).tolist() == [[2, -1, 3], [5, -4, 6]]


def test_angles_that_turn_freely_come_into_their_range():
    command = np.array([[1.1, 5.0, 0.2], [1.1, -9.0, 0.2]])
    turned = wrapped(command, MACHINE)
    assert np.exp(1j * turned) == pytest.approx(np.exp(1j * command))
    psi = MACHINE.command[1]
    assert [c for c in MACHINE.command if turns_freely(c)] == [psi]
    assert (turned[:, 1] >= psi.lower).all()
    assert (turned[:, 1] <= psi.upper).all()


def test_a_share_of_the_range_may_be_exceeded():
    z = MACHINE.command[0]
    beyond = z.upper + 0.1 * (z.upper - z.lower)
    command = np.array([[beyond, 0.0, 0.1]])
    tool = (0.0, 0.0, 0.0)
    assert not inside(command, MACHINE, tool, 0.0)
    assert not inside(command, MACHINE, tool, 0.09)
    assert inside(command, MACHINE, tool, 0.11)


def test_changed_commands_have_the_oracles_joints(session):
    """Taught poses stay: they are not commanded in the file's rows."""
    (first, *_) = session.series
    moved = commanded(session.measurement, shifted(1, 0.2))(first)
    of_file = commanded_in_file(first, is_taught=True)
    assert 0 < (~of_file).sum() < len(of_file)
    assert moved.command[~of_file] == pytest.approx(first.command[~of_file])
    tool = session.measurement.setups[first.setup].tool[2]
    z, psi, theta = first.command[of_file].T
    exact = a3.inverse_nominal(z, psi + 0.2, theta, tool)
    assert moved.q[of_file] == pytest.approx(exact, abs=1e-10)


def test_changed_joints_lead_to_the_oracles_poses(session):
    (first, *_) = session.series
    moved = jointed(session.measurement, shifted(0, 1e-3))(first)
    assert moved.q - first.q == pytest.approx(
        np.tile([1e-3, 0.0, 0.0], (len(first.q), 1))
    )
    kinematics = session.measurement.kinematics
    rotation, _, _ = kinematics.frames(moved.start, np.zeros(3))
    exact = a3.forward(np.zeros(24), moved.q)
    assert rotation == pytest.approx(exact.R, abs=1e-8)


def test_runs_are_told_by_their_names(session):
    (first, *_) = session.series
    runs = readings_by_run(first)
    assert np.sort(np.concatenate(runs)).tolist() == list(range(len(first)))
    assert all(len({first.run[k] for k in run}) == 1 for run in runs)


def test_a_run_with_a_pose_out_of_reach_is_left_out(session):
    (first, *_) = session.series
    lost = first.run[0]

    def moved(series: Series) -> Series:
        if lost in series.run:
            raise AssemblyError("out of reach", series.index[:1, 0])
        return series

    reached = moved_rows(first, moved)
    others = [k for k, name in enumerate(first.run) if name != lost]
    assert 0 < len(others) < len(first)
    assert reached[0].tolist() == others
    assert moved_rows(first, lambda series: None) is None


def test_a_table_has_what_the_nominal_machine_reads(session):
    given = Suspect(session)
    moved = commanded(session.measurement, shifted(1, 0.2))
    table = pose_table(given, moved)
    assert table is not None
    trial = next(moved_trials(given, "sign", "psi is off", moved))
    assert trial.scope.level == "file"
    (other,) = trial.undo(trial.amounts)
    predicted = []
    for series in other.series:
        tool = session.measurement.setups[series.setup].tool[2]
        z, psi, theta = series.command.T
        joints = a3.inverse_nominal(z, psi, theta, tool)
        points = a3.forward(np.zeros(24), joints, tool).tip
        pairs = points[series.index[:, 0]] - points[series.index[:, 1]]
        predicted.append(np.linalg.norm(pairs, axis=1))
    assert table.predicted == pytest.approx(np.concatenate(predicted), abs=1e-9)


TRAVEL = np.array([0.3, 0.9, 0.1, 0.7, 0.5, 0.8, 0.2, 0.6, 0.4])


def stops(far: np.ndarray, sign: float) -> list[float]:
    """Likely stops of sign * TRAVEL where these of its readings are ten sigma off."""
    session = SimpleNamespace(
        joints=sign * TRAVEL[:, None],
        y=np.where(far, 10.0, 1.0),
        reading_of_value=np.arange(len(TRAVEL)),
    )
    data = SimpleNamespace(session=session, predicted=np.zeros(9), spread=np.ones(9))
    return _likely_stops(data, 0, sign)  # type: ignore[arg-type]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stop_lies_between_readings_that_fit_and_those_beyond(sign):
    between, lowest = stops(TRAVEL > 0.75, sign)
    assert between * sign == pytest.approx(0.75)
    assert lowest * sign == pytest.approx(0.7)
    one_fits = (TRAVEL > 0.65) & (TRAVEL != 0.8)
    assert sign * stops(one_fits, sign)[0] == pytest.approx(0.65)


@pytest.mark.parametrize("far", [TRAVEL < 0.25, TRAVEL > 0.55, TRAVEL > 1.0])
def test_no_stop_at_the_other_end_nor_of_many_nor_of_none(far):
    assert stops(far, 1.0) == []


@pytest.mark.parametrize("count", [2, 3, 4, 6])
def test_orders_of_joints_are_turns_reflections_and_exchanges(count):
    """A symmetric search: each order is tried once, and so is what undoes it."""
    orders = likely_orders(count)
    steps = np.arange(count)
    wanted = {tuple(np.roll(steps[::way], k)) for k in steps for way in (1, -1)}
    for i, k in itertools.combinations(steps, 2):
        swapped = steps.copy()
        swapped[[i, k]] = k, i
        wanted.add(tuple(swapped))
    assert set(orders) == wanted - {tuple(steps)}
    assert len(set(orders)) == len(orders)
    assert {tuple(np.argsort(order)) for order in orders} == set(orders)


def directed_session(m, series, rows):
    return checks.session_readings(m, [series], np.zeros(len(rows)), rows)


@pytest.fixture(scope="module")
def planned() -> tuple[Measurement, Series, pd.DataFrame]:
    m = a3_plans.measurement()
    return (m, *a3_machines.planned(m))


def test_order_and_direction_go_together(planned):
    assert not contradictions(directed_session(*planned))
    m, series, rows = planned
    assert not contradictions(
        directed_session(m, series, rows.drop(columns="direction"))
    )
    outlined = dataclasses.replace(directed_session(*planned)).without([3, 40, 41])
    assert not contradictions(outlined)


def test_a_wrong_direction_contradicts_every_run_of_the_same_circle(planned):
    m, series, rows = planned
    wrong = np.where(rows["run"] == "80-1", 1, rows["direction"])
    pairs = contradictions(directed_session(m, series, rows.assign(direction=wrong)))
    assert len(pairs) == 5
    assert all("80-1" in pair.runs for pair in pairs)
    assert {pair.same_order for pair in pairs} == {True, False}


def test_rows_sorted_by_angle_are_found(planned):
    """Runs both ways, written in the order of the angle: the order is not that of travel."""
    m, series, rows = planned
    backward = [r for r in dict.fromkeys(rows["run"]) if int(r[-1]) % 2]
    found = contradictions(directed_session(m, series, turned(rows, backward)))
    assert len(found) == 2 * 3 * 3
    assert all(pair.same_order for pair in found)
