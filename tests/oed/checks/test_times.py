"""Times that no session has: falling, standing still, in other units, two runs at once."""

import dataclasses
from typing import cast

import numpy as np
import pandas as pd
import pytest
from shipped_models import planar_2dof, pose_tracker

from oed import checks
from oed.checks.findings import Severity
from oed.checks.session import SessionReadings
from oed.checks.times import TimedRun, _with, wrong_times
from oed.instrument import mount
from oed.measurement import Measurement

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
