"""Each mistake, made in readings of an independent machine, undone again."""

import functools
from types import ModuleType

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest
from blunder_table import BLUNDERS
from blunders import Blunder

from oed.checks.mistakes import (
    Suspect,
    amounts,
    carried,
    contradiction,
    frames,
    joints,
    limits,
    order,
    pose,
    setups,
    sorting,
    values,
)
from oed.checks.mistakes.trial import MistakeTrial

BY_NAME = {blunder.name: blunder for blunder in BLUNDERS}
#: mistakes without amounts, or with those, SI, that were made
MADE: list[tuple[ModuleType, str, tuple[float, ...]]] = [
    (values, "one run in inches", ()), (values, "angles in rad", ()),
    (values, "one display of two in inches", ()),
    (values, "one run in um of deviation", ()), (values, "length added to lengths", ()),
    (values, "reversed deviations in one run", ()),
    (values, "one gauge in two lines' channels, reversed", ()),
    (values, "half of the deviations of one run", ()),
    (values, "one gauge in two lines' channels, halved", ()),
    (frames, "tracker turned by 90 deg", ()), (order, "readings one row late", ()),
    (order, "runs read backward", ()), (order, "run labels exchanged", ()),
    (sorting, "poses of one run sorted", ()), (setups, "set-ups exchanged", ()),
    (pose, "tilts exchanged", ()),
    (pose, "one circle starts 17 deg late", (np.deg2rad(17.0),)),
    (joints, "two legs exchanged", ()), (order, "three runs under other names", ()),
    (order, "two runs interleaved", ()),
    (order, "runs in the order of numbers as text", ()),
    (values, "a decimal point lost in one run", ()),
    (frames, "tracker left-handed", ()), (frames, "passive rotations", ()),
    (frames, "angles in another order", ()),
    (carried, "read before it settled", (0.3,)),
    (limits, "revolutions not counted", ()),
    (amounts, "zeroed again in one run", (0.2e-3,)),
    (amounts, "the bar zeroed again at row 32", (0.2e-3,)),
    (amounts, "scale of the bar", (0.01 / 1.01,)),
    (amounts, "one gauge in two lines' channels, 25 % large", (0.2,)),
]  # fmt: skip


def session(blunder: Blunder) -> Suspect:
    rows = blunder.make(machines.readings(blunder.machine, 0))
    return Suspect(machines.session(blunder.machine, rows))


@functools.cache
def without_mistake(machine: str) -> pd.Series:
    return misfit(Suspect(machines.session(machine, machines.readings(machine, 0))))


def misfit(given: Suspect) -> pd.Series:
    """Readings less those of the nominal machine, SI, by row of the file and channel."""
    rows = pd.MultiIndex.from_frame(given.session.values[["row", "channel"]])
    return pd.Series(given.session.y - given.predicted, index=rows)


def trials(module, blunder, given, amounts):
    """Trials with the words that a check must say."""
    for trial in module.trials(given):
        known = len(trial.amounts) == len(amounts)
        if known and blunder.is_named([trial.text(amounts, 0.01 * np.abs(amounts))]):
            yield trial


@pytest.mark.parametrize(("module", "name", "made"), MADE)
def test_a_mistake_undone_leaves_the_readings_without_it(module, name, made):
    """Of readings one row late the last is lost."""
    blunder, amount = BY_NAME[name], np.array(made)
    given, right = session(blunder), without_mistake(blunder.machine)
    assert (misfit(given) - right).abs().max() > 1e-5

    def is_right(trial: MistakeTrial) -> bool:
        rest = misfit(Suspect(*trial.undo(amount)))
        errors = (rest - right).abs().dropna()
        return len(errors) >= len(right) - 1 and errors.max() < 2e-6

    assert any(is_right(t) for t in trials(module, blunder, given, amount))


def test_readings_against_the_last_pose_refer_to_it():
    blunder = BY_NAME["differences from the last pose"]
    given = session(blunder)
    trial = next(trials(setups, blunder, given, np.zeros(0)))
    (undone,) = trial.undo(trial.amounts)
    for series in undone.series:
        for run in np.unique(series.run):
            rows = series.run == run
            assert (series.index[rows, 1] == series.index[rows, 0].max()).all()


@pytest.mark.parametrize(("module", "name", "rows"), [
    (contradiction, "one set-up's readings in both", "long_tool"),
    (contradiction, "nonsense in one run", "cup 2"),
])  # fmt: skip
def test_readings_of_no_use_are_left_out(module, name, rows):
    blunder = BY_NAME[name]
    given = session(blunder)
    trial = next(trials(module, blunder, given, np.zeros(0)))
    (rest,) = trial.undo(trial.amounts)
    of_scope = (given.session.values[["setup", "run"]] == rows).any(axis=1)
    assert trial.missing is not None
    assert (trial.missing == of_scope).all()
    assert (rest.y == given.session.y[~of_scope]).all()


def test_two_machines_are_divided_at_the_row_of_the_change():
    blunder = BY_NAME["half from another machine"]
    given = session(blunder)
    trial = next(trials(contradiction, blunder, given, np.zeros(0)))
    first, second = trial.undo(trial.amounts)
    assert (first.y == given.session.y[:20]).all()
    assert (second.y == given.session.y[20:]).all()


def test_another_program_reads_the_same_on_the_nominal_machine():
    """A circle 10 mm higher whose tilts keep the bar's length."""
    blunder = BY_NAME["the circle of another height"]
    given = session(blunder)
    height = np.array([-10e-3])
    trial = next(trials(pose, blunder, given, height))
    (driven,) = trial.undo(height)
    of_run = driven.values["run"].to_numpy() == "cup 2"
    read = Suspect(driven).predicted
    assert read[of_run] == pytest.approx(np.full(12, 0.3), abs=1e-7)
    heights = np.concatenate([s.reading_commands()[:, 0] for s in driven.series])
    assert heights[of_run] == pytest.approx(np.full(12, 1.276), abs=1e-9)


def test_programs_out_of_reach_are_not_followed_from_home(monkeypatch):
    """Newton's steps to the bar's length leave the workspace for tilts far off."""

    def follow(*arguments: object) -> None:
        raise AssertionError("hundreds of steps")

    given = session(BY_NAME["the circle of another height"])
    kinematics = given.session.measurement.kinematics
    names = [c.name for c in kinematics.machine.command]
    monkeypatch.setattr(type(kinematics._inverse), "_follow", follow)
    displaced = pose._follower_trials(given, names.index("theta"), names.index("z"))
    assert {trial.family for trial in displaced}


@pytest.mark.parametrize(("name", "words"), [
    ("bar longer by 0.5 mm", "the bar length or the zero of the instrument"),
    ("the bar zeroed again at row 32", "the set-up moved or was zeroed again"),
])  # fmt: skip
def test_an_offset_has_the_cause_of_its_scope(name, words):
    blunder, amount = BY_NAME[name], np.array([0.5e-3])
    named = list(trials(amounts, blunder, session(blunder), amount))
    assert named
    assert all(words in t.text(amount, 0.01 * amount) for t in named)


@pytest.mark.parametrize(("machine", "count"), [("a3", 1), ("planar", 2)])
def test_offsets_of_a_file_are_one_family_a_channel(machine, count):
    """Of a family the likeliest alone is fitted: channels must not stand for each other."""
    given = Suspect(machines.session(machine, machines.readings(machine, 0)))
    families = [
        trial.family
        for trial in amounts.trials(given)
        if trial.kind == "offset" and trial.scope.level == "file"
    ]
    assert len(families) == len(set(families)) == count
    if count == 1:
        assert families == [f"offset {given.file.name}"]
