"""Mistakes of a table, and of kinds that no table had, undone again."""

import functools
from collections.abc import Callable
from types import ModuleType

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest
from blunder_table import BLUNDERS
from blunder_tables import DEG, Array
from blunders import Blunder
from scipy.spatial.transform import Rotation

from oed.base import Orientation
from oed.checks.explain import as_given
from oed.checks.findings import PHYSICAL_KINDS
from oed.checks.fit import fit, fit_of_any_misfit
from oed.checks.mistakes import (
    MistakeTrial,
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
    tools,
    values,
)
from oed.checks.screening import Screening

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


Change = Callable[[pd.DataFrame], pd.DataFrame]
PLACE = ["read_x_mm", "read_y_mm", "read_z_mm"]
TRACKED = ["read_alpha_deg", "read_beta_deg", "read_gamma_deg"]


def rotations(rows: pd.DataFrame) -> Rotation:
    return Rotation.from_euler("XYZ", rows[TRACKED].to_numpy(), degrees=True)


def of_run(rows: pd.DataFrame, run: str) -> Array:
    return np.flatnonzero(rows["run"] == run)


def bar_mounted_anew(rows: pd.DataFrame) -> pd.DataFrame:
    rows.loc[of_run(rows, "long_tool 2"), "length_mm"] -= 0.035
    return rows


def other_nest(rows: pd.DataFrame) -> pd.DataFrame:
    at = of_run(rows, "set 2")
    aside = rotations(rows.loc[at]).apply([0.0, 0.0, -8.0])
    rows.loc[at, PLACE] += aside
    return rows


def other_ball(rows: pd.DataFrame) -> pd.DataFrame:
    at = of_run(rows, "height 1")
    alpha, beta = rows.loc[at, ["read_alpha_deg", "read_beta_deg"]].to_numpy().T * DEG
    axis = [np.sin(beta), -np.sin(alpha) * np.cos(beta), np.cos(alpha) * np.cos(beta)]
    rows.loc[at, PLACE] -= 100.0 * np.column_stack(axis)
    return rows


def in_minutes(rows: pd.DataFrame) -> pd.DataFrame:
    """Degrees with minutes in the place of decimals: 9.3125 deg is 9.1875."""
    size = rows[TRACKED].abs()
    minutes = np.floor(size) + 0.6 * (size % 1.0)
    rows[TRACKED] = (np.sign(rows[TRACKED]) * minutes).round(6)
    return rows


def scaled(rows: pd.DataFrame) -> pd.DataFrame:
    rows[PLACE] = (rows[PLACE] / 1.1).round(4)
    return rows


def bumped(rows: pd.DataFrame) -> pd.DataFrame:
    rows.loc[of_run(rows, "set 3")[2:6], "read_y_mm"] += 1.0
    return rows


def as_vectors(rows: pd.DataFrame) -> pd.DataFrame:
    rows[TRACKED] = rotations(rows).as_rotvec(degrees=True).round(5)
    return rows


SLOW = pytest.mark.slow
KINDS = [
    ("a3", bar_mounted_anew, amounts, "length_mm in run long_tool 2 are off by -3", -3.5e-5),
    ("prs", other_ball, tools, "the tool in run height 1 is 100 mm", -0.1),
    ("hexapod", other_nest, tools, "the tool in run set 2 is 8", -8e-3),
    ("hexapod", in_minutes, values, "have minutes after their decimal point", None),
    ("hexapod", scaled, amounts, "read_x_mm, read_y_mm, read_z_mm are 9", 1.0 - 1.1),
    ("hexapod", bumped, amounts, "read_y_mm in rows 20 to 23 are off by 9", 1e-3),
    ("hexapod", as_vectors, frames, "of one rotation vector", None),
]  # fmt: skip


@pytest.mark.parametrize(("machine", "change", "module", "words", "amount"), KINDS)
def test_a_kind_undone_leaves_the_readings_without_it(
    machine, change, module, words, amount
):
    """To three hundredths where a target elsewhere goes with the nominal orientation."""
    rows = machines.readings(machine, 4)
    clean = Suspect(machines.session(machine, rows.copy()))
    given = Suspect(machines.session(machine, change(rows)))
    size = np.array([] if amount is None else [amount])
    right, limit = misfit(clean), 3e-2 * np.abs(size).sum() if module is tools else 2e-6

    def is_right(trial: MistakeTrial) -> bool:
        says = words.split(" is ")[0].split(" are ")[0]
        if trial.amounts.shape != size.shape or says not in trial.text(
            size, 0.01 * size
        ):
            return False
        rest = misfit(Suspect(*trial.undo(size)))
        return bool((rest - right).abs().max() < limit)

    assert (misfit(given) - right).abs().max() > 3e-5
    assert any(is_right(trial) for trial in module.trials(given))


@pytest.mark.parametrize(("column", "row"), [("alpha_deg", 10), ("beta_deg", 14)])
def test_a_command_that_was_typed_wrongly_is_said(column, row):
    """A sign that was left out, in one row."""
    rows = machines.readings("prs", 4)
    right = rows.loc[row, column]
    assert abs(right) > 5.0
    rows.loc[row, column] = -right
    checked = machines.check("prs", rows)
    (said,) = [f.sentence for f in checked.findings if f.rows == (row + 2,)]
    assert (
        f"With the other sign of the command, {column} = {right:.9g}, it fits" in said
    )


def test_a_pose_that_is_its_own_reference_has_no_fit():
    """The distance of a pose from itself has no slope."""
    rows = machines.readings("delta", 4)
    at = np.flatnonzero(rows["length_mm"].notna())[2]
    rows.loc[at, ["x_mm", "y_mm", "z_mm"]] = rows.loc[at - 3, ["x_mm", "y_mm", "z_mm"]]
    assert fit(machines.session("delta", rows)) is None


# -- each in what it computes ----------------------------------------------------------
def test_lines_of_a_meander_turn_round():
    key = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0])
    rows = np.arange(10, 17)
    key = np.concatenate([np.zeros(10), key])
    second = [10, 11, 12, 14, 13, 15, 16]
    first = [12, 11, 10, 13, 14, 16, 15]
    assert order._turn_lines(key, 1, rows).tolist() == second
    assert order._turn_lines(key, 0, rows).tolist() == first
    assert order._turn_lines(np.zeros(17), 0, rows).tolist() == rows.tolist()


def test_a_grid_read_as_a_meander_is_put_in_order():
    rows = machines.readings("prs", 4)
    height = of_run(rows, "height 1")
    for name, angles in (("alpha_deg", [-9.0, 0.0, 9.0]), ("beta_deg", [-6.0, 6.0])):
        rows.loc[height, name] = 0.0
        across = angles if name == "alpha_deg" else np.repeat(angles, 3)
        rows.loc[height[:6], name] = np.resize(across, 6)
    given = Suspect(machines.session("prs", rows))
    whole = given.session.y
    names = [t for t in order.trials(given) if "meander" in t.text(*[np.zeros(0)] * 2)]
    of_lines = [t for t in names if t.scope.name == "run height 1"]
    assert of_lines
    for trial in of_lines:
        (changed,) = trial.undo(trial.amounts)
        assert sorted(changed.y) == sorted(whole)


def test_angles_of_a_controller_by_another_convention():
    """Roll, pitch and yaw in the columns of a tilt and a spin, by SciPy's rotations."""
    own = Orientation.tilt_and_spin("rx", "ry", "spin")
    by_words = {m.text: m for m in frames._mistakes(own)}
    one = by_words["have angles in another order: R = Rz(spin) Ry(ry) Rx(rx)"]
    poses = np.array([[1.0, 2.0, 3.0, 0.2, -0.3, 0.4], [0.0, 0.0, 1.0, -0.1, 0.2, 0.3]])
    right = frames._unframed(own, one, poses)
    angles = dict(zip(own.names, right[:, 3:].T, strict=True))
    wanted = Rotation.from_euler("xyz", poses[:, 3:]).as_matrix()
    assert own.matrices(angles) == pytest.approx(wanted, abs=1e-12)
    assert (right[:, :3] == poses[:, :3]).all()


def test_readings_are_linear_about_a_fit_as_well():
    """There they predict what the fit reads, to rounding."""
    session = machines.session("a3", bar_mounted_anew(machines.readings("a3", 4)))
    solution = fit_of_any_misfit(session, 10.0)
    plain, near = Suspect(session), Suspect(session, at=solution)
    read = near.predicted + near.slopes @ solution.departure
    measurement = session.measurement
    exact = measurement.readings(session.series, solution.theta)
    assert read == pytest.approx(exact, abs=1e-12)
    by_nominal = plain.predicted + plain.slopes @ solution.departure
    assert np.abs(by_nominal - exact).max() > 1e-6
    every = np.ones(len(session), dtype=bool)
    assert near.bases(every)["the nominal length"][0] == 0.3
    evidence = [Screening(g).as_given().log_evidence for g in (plain, near)]
    assert evidence[1] > evidence[0]


def test_a_stretch_is_the_one_that_lessens_the_misfit_most():
    """By the exact misfit with an offset of each stretch, in the linear model."""
    session = machines.session("hexapod", bumped(machines.readings("hexapod", 4)))
    given = Suspect(session)
    of_rows = [
        t for t in amounts.trials(given) if t.kind == "run" and t.log_prior < 0.0
    ]
    of_y = [t for t in of_rows if "read_y_mm" in t.text(np.ones(1), np.ones(1))]
    assert len(of_y) == amounts.N_STRETCHES
    assert of_y[0].scope.name == "rows 20 to 23"

    def misfit(y: Array) -> float:
        covariance = given.slopes @ given.slopes.T + np.diag(given.sigma**2)
        away = y - given.predicted
        return float(away @ np.linalg.solve(covariance, away))

    left = []
    for trial in of_y:
        assert trial.columns is not None
        sizes = np.linspace(0.5e-3, 1.5e-3, 101)
        left.append(min(misfit(session.y - trial.columns[:, 0] * s) for s in sizes))
    assert np.argmin(left) == 0


# -- what is none of them --------------------------------------------------------------
def noisier(factor: float, column: str) -> Change:
    def change(rows: pd.DataFrame) -> pd.DataFrame:
        rng = np.random.default_rng(17)
        rows[column] += 0.5e-3 * factor * rng.standard_normal(len(rows))
        return rows

    return change


def bent(size: float, column: str, command: str) -> Change:
    """A deflection that follows a command, smooth and of third order."""

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        place = rows[command] - rows[command].mean()
        rows[column] += size * (place / place.abs().max()) ** 3
        return rows

    return change


def warming(size: float, column: str) -> Change:
    """Growth that saturates."""

    def change(rows: pd.DataFrame) -> pd.DataFrame:
        rows[column] += size * (1.0 - np.exp(-np.arange(len(rows)) / 15.0))
        return rows

    return change


def backlash(size: float, column: str, command: str) -> Change:
    def change(rows: pd.DataFrame) -> pd.DataFrame:
        rows[column] += size * np.sign(np.gradient(rows[command]))
        return rows

    return change


@pytest.mark.parametrize(("machine", "change"), [
    pytest.param("a3", noisier(6.0, "length_mm"), marks=SLOW),
    pytest.param("delta", bent(0.3, "height_mm", "x_mm"), marks=SLOW),
    pytest.param("hexapod", warming(0.2, "read_z_mm"), marks=SLOW),
    pytest.param("delta", backlash(0.08, "height_mm", "y_mm"), marks=SLOW),
])  # fmt: skip
def test_effects_and_noise_are_no_mistakes(machine, change):
    """What an effect can mimic may be named as such a mistake, and nothing else."""
    checked = machines.check(machine, change(machines.readings(machine, 4)))
    kinds = {one.kind for one in checked.explanations}
    assert kinds <= set(PHYSICAL_KINDS), [one.what for one in checked.explanations]


def test_an_error_of_a_run_beyond_noise_is_no_law():
    """Readings of one run 70 times the noise apart: nothing but a mistake says so."""
    session = machines.session("a3", bar_mounted_anew(machines.readings("a3", 4)))
    clean = machines.session("a3", machines.readings("a3", 4))
    spoiled, right = (as_given(fit_of_any_misfit(s, 1.0)) for s in (session, clean))
    assert spoiled.log_posterior < right.log_posterior - 20.0
