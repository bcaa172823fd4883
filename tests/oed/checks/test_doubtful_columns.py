"""Covariates, poses, zeros and times that no workshop has, and what they may mean."""

import dataclasses
import itertools
from typing import cast

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest
from blunder_spatial import prs_poses
from blunder_table import interpolated, two_digits_exchanged
from shipped_models import planar_2dof, pose_tracker

from oed import checks
from oed.checks import check, copies
from oed.checks.explain import candidates
from oed.checks.findings import Severity
from oed.checks.mistakes import Suspect, amounts, noise, tools
from oed.checks.screening import Screening
from oed.checks.session import SessionReadings
from oed.checks.times import TimedRun, _with, wrong_times
from oed.dataset import ReadingsError, column_meanings
from oed.instrument import mount
from oed.measurement import Measurement
from oed.model import Coordinate

DEG = np.pi / 180.0


@pytest.mark.parametrize(("column", "value", "words"), [
    ("temp_platform_C", 293.15, "kelvin, not Celsius"),
    ("temp_platform_C", -300.0, "below absolute zero"),
    ("temp_platform_C", 9999.0, "no value"), ("payload_N", 1e9, "0 to 100000 N"),
    ("payload_N", -100.0, "cannot be negative"),
    ("feed_mm_min", 1e6, "0 to 300000 mm_min"),
])  # fmt: skip
def test_a_covariate_no_workshop_has_is_doubted_by_row(column, value, words):
    rows = machines.readings("a3", 0).assign(**{column: 20.0})
    rows.loc[[3, 9], column] = value
    (finding,) = check.doubtful_conditions(machines.session("a3", rows))
    assert finding.rows == (5, 11)
    assert words in finding.sentence
    assert column in finding.sentence


def test_usual_covariates_are_not_doubted():
    """A workshop at -5 C, a head of 60 C, a feed of 60 m/min, a load of 500 kg."""
    rows = machines.readings("a3", 0).assign(
        temp_base_C=-5.0, temp_platform_C=60.0, feed_mm_min=6e4, payload_N=4905.0
    )
    rows.loc[4, "temp_base_C"] = np.nan
    assert not check.doubtful_conditions(machines.session("a3", rows))


def test_notations_of_an_angle_are_those_of_a_calculator():
    theta = Coordinate("theta", "rad", 0.0, 40.0 * DEG)
    file = np.array([30.3045, 12.1530, 5.5900]) * DEG
    meant = {words: f(file) / DEG for words, f in column_meanings(theta, file).items()}
    of_minutes = meant["{} has minutes and seconds after its decimal point"]
    in_hand = [30 + 30 / 60 + 45 / 3600, 12 + 15 / 60 + 30 / 3600, 5 + 59 / 60]
    assert of_minutes == pytest.approx(in_hand, abs=1e-9)
    assert meant["{} is in grad, not in deg"][0] == pytest.approx(27.27405)
    assert meant["{} is counted from the other axis, as 90 deg less it"][0] == (
        pytest.approx(59.6955)
    )
    from_the_end = meant["{} is counted from the other end of its values"]
    assert from_the_end == pytest.approx([5.59, 23.7415, 30.3045])


def test_no_minutes_are_read_from_more_than_sixty():
    theta = Coordinate("theta", "rad", 0.0, 40.0 * DEG)
    meant = column_meanings(theta, np.array([30.75, 12.15]) * DEG)
    assert not [words for words in meant if "minutes" in words]


def test_poses_out_of_the_workspace_say_what_their_column_may_mean(tmp_path):
    rows = machines.readings("a3", 0)
    rows["theta_deg"] = 90.0 - rows["theta_deg"]
    with pytest.raises(ReadingsError, match="theta_deg is counted from the other axis"):
        machines.session("a3", rows)


def test_three_rows_half_way_between_their_neighbours_are_interpolated():
    rows = machines.readings("a3", 0)
    session = machines.session("a3", interpolated(rows))
    found = copies.interpolated_readings(session)
    assert session.rows(found) == (10, 22, 35)
    assert not copies.interpolated_readings(machines.session("a3", rows)).size


def test_exchanged_digits_are_named_with_the_number_that_fits():
    rows = machines.readings("a3", 0)
    right = rows.loc[20, "length_mm"]
    checked = machines.check("a3", two_digits_exchanged(rows))
    (finding,) = [f for f in checked.findings if f.kind == "outlier"]
    assert finding.rows == (22,)
    assert f"digits exchanged it is {right:.9g}" in finding.sentence


@pytest.mark.parametrize("pair", [(0, 2)])
def test_any_runs_of_a_set_up_may_have_one_mistake(pair):
    """The likeliest mistake in the linear model is that which was made, and where."""
    rows = machines.readings("planar", 0)
    names = list(dict.fromkeys(rows["run"]))
    wrong = rows["run"].isin([names[k] for k in pair])
    rows.loc[wrong, "dy_mm"] *= 0.1
    given = Suspect(machines.session("planar", rows))
    first, _ = candidates(given, Screening(given), thorough=True)
    likeliest = first[0].trial
    at = given.session.values["run"].isin([names[k] for k in pair])
    assert likeliest.kind == "scale"
    inside = np.isin(given.session.reading_of_value, likeliest.scope.readings)
    assert np.array_equal(inside, at)


def test_the_stated_noise_is_doubted_where_readings_fit_a_thousand_times_better():
    given = Suspect(machines.session("a3", machines.readings("a3", 0)))
    (trial,) = [t for t in noise.noise_trials(given) if t.noise.max() == 1e3]
    (other,) = trial.undo(trial.amounts)
    assert other.noise().sigma == pytest.approx(1e3 * given.sigma)


def test_a_rounded_command_is_noise_of_its_slope():
    """Variance of a uniform error of one degree: a twelfth, times the slope squared."""
    rows = machines.readings("a3", 0)
    rows["theta_deg"] = rows["theta_deg"].round()
    given = Suspect(machines.session("a3", rows))
    trial = next(
        t
        for t in noise.trials(given)
        if t.text(t.amounts, t.amounts)
        == "theta_deg is rounded to 1: finer numbers were driven"
    )
    moved = rows.assign(theta_deg=rows["theta_deg"] + 0.01)
    slope = (Suspect(machines.session("a3", moved)).predicted - given.predicted) / 0.01
    variance = given.sigma**2 + slope**2 / 12.0
    (other,) = trial.undo(trial.amounts)
    assert other.noise().sigma == pytest.approx(np.sqrt(variance), rel=1e-2)


def test_each_run_has_an_offset_of_its_own():
    rows = machines.readings("planar", 0)
    given = Suspect(machines.session("planar", rows))
    trial = next(
        t
        for t in amounts.trials(given)
        if t.family == "offsets dy " and t.columns is not None
    )
    made = np.arange(len(trial.amounts)) * 1e-4
    (other,) = trial.undo(made)
    taken = given.session.y - other.y
    by_run = {
        run: taken[(given.session.values["run"] == run) & (given.channel == "dy")]
        for run in dict.fromkeys(rows["run"])
    }
    for run, amount in zip(by_run, made, strict=True):
        assert by_run[run] == pytest.approx(amount)


def test_a_tool_point_beside_the_axis_is_read_there():
    """By the instrument's own model, with the tool of the set-up where it was."""
    session = machines.session("prs", machines.readings("prs", 0))
    given = Suspect(session)
    trial = next(
        t
        for t in tools.trials(given)
        if t.text(np.ones(1), np.ones(1)).startswith("the point that is read")
        and " in x " in t.text(np.ones(1), np.ones(1))
        and len(t.amounts) == 1
    )
    (other,) = trial.undo(np.array([0.025]))
    setup = other.measurement.setups[other.series[0].setup]
    (before,) = session.measurement.setups.values()
    assert np.array(setup.tool) - np.array(before.tool) == pytest.approx([0.025, 0, 0])


PAIRS = [
    f"length_mm of {one}; length_mm of {other}"
    for one, other in itertools.combinations(("cup", "long_tool", "mid_tool"), 2)
]


@pytest.mark.parametrize(("machine", "names"), [
    ("a3", []),
    ("hexapod", []),
    ("planar", ["dz_mm of ruler; dy_mm of square"]),
    ("a3 in three set-ups", PAIRS),
])  # fmt: skip
def test_where_one_instrument_may_have_been_used(machine, names):
    """Not in all channels or set-ups of the file: that is a mistake of the file."""
    session = machines.session(machine, machines.readings(machine, 0))
    scopes = Suspect(session).instruments
    wanted = [f"one instrument ({name})" for name in names]
    assert [scope.name for scope in scopes] == wanted
    for scope in scopes:
        readings = np.unique(session.reading_of_value[scope.values])
        assert np.array_equal(readings, scope.readings)


@pytest.mark.parametrize(("name", "axis"), [("range", 0), ("elevation", 1)])
def test_slopes_over_an_inner_zero_are_those_of_another_code(name, axis):
    rows = machines.readings("prs", 0)
    given = Suspect(machines.session("prs", rows))
    trial = next(t for t in amounts.trials(given) if f"zero {name} " in t.family)
    q, p, shift, turn, error = rows.attrs["machine"]
    nominal = (q, 0.0 * p, 0.0 * shift, 0.0 * turn)
    step = np.zeros_like(error)
    step[:, :, axis] = 1e-5
    by_steps = prs_poses(*nominal, step) - prs_poses(*nominal, -step)
    assert trial.columns[:, 0] == pytest.approx(by_steps.ravel() / 2e-5, abs=1e-5)


def test_an_instrument_without_inner_readings_has_no_such_zero():
    given = Suspect(machines.session("planar", machines.readings("planar", 0)))
    families = [trial.family for trial in amounts.trials(given)]
    assert not [name for name in families if name.startswith("zero ")]


PATHS = {
    "low": np.column_stack([np.linspace(-1.0, 1.0, 5), np.full(5, 0.3)]),
    "high": np.column_stack([np.linspace(-1.0, 1.0, 5), np.full(5, 0.9)]),
}


def session(times: dict[tuple[str, str], np.ndarray]) -> SessionReadings:
    """Runs of set-ups with these times; the path is named by the run's first word."""
    names = list(dict.fromkeys(setup for setup, _ in times))
    setups = [mount(pose_tracker.position, name) for name in names]
    measurement = Measurement(planar_2dof.machine, setups)
    series, parts = [], []
    for name in names:
        runs = [run for setup, run in times if setup == name]
        command = np.vstack([PATHS[run.split()[0]] for run in runs])
        labels = [run for run in runs for _ in range(5)]
        series.append(measurement.series(name, command, labels))
        parts += [times[name, run] for run in runs]
    count = sum(len(s) for s in series)
    covariates = pd.DataFrame(
        {"order": np.arange(1, count + 1), "time": np.concatenate(parts)}
    )
    y = measurement.readings(series, measurement.nominal)
    return checks.session_readings(measurement, series, y, covariates)


def from_(start: float) -> np.ndarray:
    return start + 20.0 * np.arange(5)


SOUND = {
    ("one", "low"): from_(0.0), ("one", "high"): from_(100.0),
    ("two", "low"): from_(1000.0),
}  # fmt: skip


def said(times: dict[tuple[str, str], np.ndarray]) -> list[tuple[Severity, str]]:
    return [(f.severity, f.sentence) for f in wrong_times(session(times))]


SESSIONS = {
    "one after the other": SOUND,
    "whole minutes": {key: np.floor(t / 60.0) * 60.0 for key, t in SOUND.items()},
    "by the clock": {key: 32400.0 + t for key, t in SOUND.items()},
    "two instruments at once": {("one", "low"): from_(0.0), ("two", "low"): from_(0.0)},
    "one later": {("one", "low"): from_(0.0), ("two", "low"): from_(0.0) + 3.0},
    "a week later": SOUND | {("two", "high"): from_(7.0 * 86400.0)},
    "a pause": SOUND | {("two", "high"): np.array([2e3, 2.02e3, 9e3, 9.02e3, 9.04e3])},
    "no times": SOUND | {("two", "high"): np.full(5, np.nan)},
    "a slow run": SOUND | {("two", "high"): 2000.0 + 1200.0 * np.arange(5)},
    "sorted by set-up": {("two", "low"): from_(1000.0), ("one", "low"): from_(0.0)},
}


@pytest.mark.parametrize("times", SESSIONS.values(), ids=SESSIONS)
def test_sound_times(times):
    assert not said(times)


def test_two_poses_at_one_time_contradict():
    """As where the afternoon's hours were read off a dial of twelve."""
    ((severity, sentence),) = said(SOUND | {("two", "low again"): from_(165.0)})
    assert severity == Severity.ORDER
    assert "row 10 (run high of one) is at 160 s" in sentence
    assert "row 17 (run low again of two) at 165 s" in sentence


def test_runs_that_take_turns_are_remarked():
    ((severity, sentence),) = said(SOUND | {("two", "high again"): from_(10.0)})
    assert severity == Severity.REMARK
    assert "Run low of one and run high again of two overlap in time" in sentence
    assert "from 10 s to 80 s" in sentence


@pytest.mark.parametrize(("times", "words"), [
    (from_(43170.0) % 43200.0, "A clock of 12 hours: add 12 h from row 19 on"),
    (from_(86370.0) % 86400.0, "Midnight passed: add 24 h from row 19 on"),
    (from_(3570.0) % 3600.0, "minutes and seconds alone: add 1 h from row 19 on"),
    (from_(2000.0)[::-1], "in reversed order"),
    (from_(2000.0) * [1, 1, 1e3, 1, 1], "The time of row 19 is wrong"),
    (from_(2000.0) / [1, 1, 60, 60, 60], "From row 19 on they are in min"),
    (from_(2000.0) * [1e3, 1e3, 1, 1, 1], "Up to row 18 they are in ms, not in s"),
    (from_(9000.0) - [0, 0, 9040, 9040, 9040], "set to zero at row 19"),
])  # fmt: skip
def test_times_that_go_back_contradict_the_order(times, words):
    ((severity, sentence),) = said(SOUND | {("two", "high"): times})
    assert severity == Severity.ORDER
    assert "time_s runs backward in run high of two" in sentence
    assert words in sentence


@pytest.mark.parametrize(("times", "words"), [
    (from_(2000.0) + 43200 * np.array([0, 0, 1, 1, 1]), "subtract 12 h from there on"),
    (from_(2000.0) * [1, 1, 1e3, 1e3, 1e3], "From row 19 on they are in ms"),
    (from_(2000.0) / [60, 60, 1, 1, 1], "Up to row 18 they are in min, not in s"),
    (np.full(5, 2000.0), "time_s is 2000 s in all 5 rows of run high of two"),
    (1e3 * from_(2000.0), "run high of two (row 17 on) looks as if it were in ms"),
    (from_(2000.0) / 60.0, "run high of two (row 17 on) looks as if it were in min"),
])  # fmt: skip
def test_doubtful_times_are_remarked(times, words):
    ((severity, sentence),) = said(SOUND | {("two", "high"): times})
    assert severity == Severity.REMARK
    assert words in sentence


def test_a_clock_for_each_run_or_set_up_is_remarked():
    times = {("one", "low"): from_(0.0), ("two", "high"): from_(0.0)}
    ((severity, sentence),) = said(times)
    assert severity == Severity.REMARK
    assert "time_s begins anew in each run" in sentence
    times = {
        ("one", "low"): from_(0.0),
        ("one", "high"): from_(100.0),
        ("two", "high again"): from_(0.0),
    }
    ((severity, sentence),) = said(times)
    assert "time_s begins anew in each set-up" in sentence


def test_the_afternoon_on_a_dial_of_twelve_hours():
    times = {("one", "low"): from_(42000.0), ("two", "high"): from_(5000.0)}
    ((severity, sentence),) = said(times)
    assert severity == Severity.REMARK
    assert "goes back from run low of one to run high of two (row 7)" in sentence
    assert "add 12 h" in sentence


def test_files_without_times_say_nothing():
    measurement = Measurement(planar_2dof.machine, [mount(pose_tracker.position, "t")])
    series = measurement.series("t", PATHS["low"])
    y = measurement.readings([series], measurement.nominal)
    plain = checks.session_readings(measurement, [series], y)
    assert not wrong_times(plain)
    assert plain.values["order"].min() == 1  # as in a readings file


def test_rows_of_a_second_file_may_have_the_numbers_of_the_first():
    back = from_(100.0)[::-1]
    one = session(SOUND | {("one", "high"): back})
    two = dataclasses.replace(one, values=one.values.copy())
    row = two.values["row"].to_numpy()
    two.values["row"] = np.where(row > 6, row - 5, row)
    sentences = [[f.severity for f in wrong_times(s)] for s in (one, two)]
    assert sentences[0]
    assert sentences[1] == sentences[0]


def test_only_the_runs_between_are_changed():
    class Run(str):
        def scaled(self, factor: float, later: float) -> str:
            return f"{self} x {factor} + {later}"

    runs = cast(list[TimedRun], [Run(name) for name in "abcd"])
    told = _with(runs, 1, 3, 60.0, 5.0)
    assert told == ["a", "b x 60.0 + 5.0", "c x 60.0 + 5.0", "d"]
