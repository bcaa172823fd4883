"""Times that no session has: falling, standing still, two runs at once."""

from __future__ import annotations

import numpy as np
import pandas as pd

from oed import checks
from oed.checks import clock, sentences
from oed.checks.session import SessionReadings
from oed.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import pose_tracker
from pkm_models.machines import planar_2dof

HALF_DAY = 43200.0
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
    return checks.session(measurement, series, y, covariates)


def from_(start: float) -> np.ndarray:
    return start + 20.0 * np.arange(5)


SOUND = {
    ("one", "low"): from_(0.0),
    ("one", "high"): from_(100.0),
    ("two", "low"): from_(1000.0),
}


def test_runs_one_after_the_other_are_sound() -> None:
    sound = session(SOUND)
    assert clock.timed_runs(sound)
    assert not clock.backward_runs(sound)
    assert not clock.standing_runs(sound)
    assert not clock.overlapping_runs(sound)


def test_two_instruments_that_read_at_once_are_sound() -> None:
    assert not clock.overlapping_runs(
        session({("one", "low"): from_(0.0), ("two", "low"): from_(0.0)})
    )


def test_runs_at_the_same_time_are_named() -> None:
    """As where the afternoon's hours were read off a dial of twelve."""
    readings = session(SOUND | {("two", "high again"): from_(10.0)})
    (pair,) = clock.overlapping_runs(readings)
    assert [run.name for run in pair.runs] == ["low of one", "high again of two"]
    assert (pair.begin, pair.end) == (10.0, 80.0)
    sentence = sentences.overlapping([pair]).sentence
    assert "low of one and high again of two overlap in time" in sentence


def test_a_clock_that_begins_anew_within_a_run_is_named_with_its_row() -> None:
    times = from_(HALF_DAY - 30.0) % HALF_DAY
    readings = session(SOUND | {("two", "high"): times})
    ((run, row),) = clock.backward_runs(readings)
    assert (run.name, row) == ("high of two", 2 + 15 + 2)
    assert f"row {row}" in sentences.backward([(run, row)]).sentence


def test_a_clock_that_stands_still_is_named() -> None:
    readings = session(SOUND | {("two", "high"): np.full(5, 2000.0)})
    (run,) = clock.standing_runs(readings)
    assert "2000 s" in sentences.standing([run]).sentence


def test_files_without_times_say_nothing() -> None:
    measurement = Measurement(planar_2dof.machine, [mount(pose_tracker.position, "t")])
    series = measurement.series("t", PATHS["low"])
    y = measurement.readings([series], measurement.nominal)
    assert not clock.timed_runs(checks.session(measurement, [series], y))
