"""Readings taken at other poses, and changed commands, against the oracle's head."""

import blunder_machines as machines
import numpy as np
import pytest
from oracles import a3_geometry as a3
from shipped_models import a3_head

from oed.checks.mistakes import Suspect
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
from oed.checks.session import SessionReadings
from oed.measurement import Series
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
    assert turns_freely(psi.lower, psi.upper)
    assert not turns_freely(0.0, 1.0)
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
