"""Readings: what is read back is what was written; what cannot be used is refused."""

import math

import numpy as np
import pandas as pd
import pytest
import sample
from dataset_files import loaded, refused
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oed import dataset
from oed.dataset import Dataset, ReadingsError
from oed.measurement import Measurement


@pytest.fixture(scope="module")
def head() -> Measurement:
    return sample.resolved().measurement


@pytest.fixture(scope="module")
def delta() -> Measurement:
    return sample.resolved(sample.DELTA).measurement


def test_commands_covariates_and_readings_come_in_si(head, tmp_path):
    found = loaded(sample.READINGS, head, tmp_path)
    np.testing.assert_allclose(found.y, [0.300001, 0.300002, 0.299999], rtol=1e-15)
    (series,) = found.series
    np.testing.assert_allclose(
        series.reading_commands()[1], [1.146, math.pi / 2, math.pi / 6], rtol=1e-14
    )
    assert list(series.run) == ["low", "low", "high"]
    assert list(found.covariates["order"]) == [1, 2, 1]
    assert list(found.covariates["time"]) == [0.0, 6.0, 20.0]
    assert list(found.covariates["row"]) == [2, 3, 5]
    assert math.isnan(found.covariates["temp_bar"][1])
    assert found.dropped == 1


def test_the_first_row_of_a_run_is_its_reference(delta, tmp_path):
    found = loaded(sample.DELTA_READINGS, delta, tmp_path)
    assert found.setups == ("probe", "calliper")
    probe, calliper = found.series
    assert len(probe) == 2
    assert calliper.index.tolist() == [[1, 0], [3, 2]]
    np.testing.assert_allclose(calliper.q[calliper.index[1, 1]], [0.400, 0.400, 0.410])
    np.testing.assert_allclose(found.y[found.spans[1]], [0.0647, 0.0648])
    assert head_of(found.take(["calliper"])) == ["calliper", "calliper"]
    assert len(found.take([])) == 0
    with pytest.raises(KeyError, match="no readings"):
        found.take(["cup"])


def head_of(found: Dataset) -> list[str]:
    return list(found.covariates["setup"])


def test_a_run_without_readings_goes_with_its_reference(delta, tmp_path):
    text = sample.changed(sample.DELTA_READINGS, (",64.8", ","))
    found = loaded(text, delta, tmp_path)
    assert found.dropped == 1
    assert [len(s) for s in found.series] == [2, 1]
    assert list(found.series[1].run) == ["d1"]


def test_rows_are_taken_in_time(head, tmp_path):
    first, *rows = sample.READINGS.splitlines()
    found = loaded("\n".join([first, *reversed(rows)]), head, tmp_path)
    assert list(found.covariates["order"]) == [1, 1, 2]
    assert list(found.covariates["run"]) == ["high", "low", "low"]


def test_files_are_taken_together_and_must_not_meet(head, tmp_path):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    paths[0].write_text(sample.READINGS, encoding="utf-8")
    paths[1].write_text(
        sample.READINGS.replace(",low,", ",again,").replace(",high,", ",top,"),
        encoding="utf-8",
    )
    assert len(dataset.load(paths, head)) == 6
    with pytest.raises(ReadingsError, match="used twice"):
        dataset.load([paths[0], paths[0]], head)


# -- round trip ------------------------------------------------------------------------
number = st.floats(min_value=-1.0, max_value=1.0, allow_nan=False, width=64)
SHARED = [HealthCheck.function_scoped_fixture]
row = st.tuples(
    st.floats(1.066, 1.266),
    st.floats(-2.0 * math.pi, 2.0 * math.pi),
    st.floats(0.0, math.radians(39.9)),
    st.sampled_from(["1", "a,b", 'say "x"', "ü"]),
    number,
    st.one_of(st.just(math.nan), st.floats(0.0, 1e6)),
)


@settings(max_examples=40, deadline=None, suppress_health_check=SHARED)
@given(rows=st.lists(row, min_size=1, max_size=12))
def test_what_is_written_is_read_back(rows, head, tmp_path):
    rows = sorted(
        rows, key=lambda r: [r[3] for r in rows].index(r[3])
    )  # runs come one after the other
    command, y = np.array([r[:3] for r in rows]), np.array([r[4] for r in rows])
    covariates = pd.DataFrame(
        {"time": [r[5] for r in rows], "feed": [abs(r[4]) for r in rows]}
    )
    made = dataset.from_series(
        [head.series("cup", command, [r[3] for r in rows])], y, head, covariates
    )
    path = tmp_path / "round.readings.csv"
    path.write_text(dataset.to_csv(made), "utf-8")
    again = dataset.load(path, head)
    np.testing.assert_allclose(again.y, y, rtol=1e-14, atol=1e-300)
    np.testing.assert_allclose(
        again.series[0].reading_commands(), command, rtol=1e-14, atol=1e-300
    )
    np.testing.assert_allclose(again.series[0].q, made.series[0].q, rtol=1e-12)
    assert list(again.series[0].run) == [r[3] for r in rows]
    for name in ("order", "time", "feed"):
        np.testing.assert_allclose(
            again.covariates.get(name, np.nan),
            made.covariates[name].astype(float),
            rtol=1e-14,
        )
    assert list(tmp_path.iterdir()) == [path]


@settings(max_examples=15, deadline=None, suppress_health_check=SHARED)
@given(
    lengths=st.lists(st.integers(2, 4), min_size=1, max_size=4),
    seed=st.integers(0, 2**32 - 1),
)
def test_joints_and_references_are_read_back(lengths, seed, delta, tmp_path):
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.38, 0.42, (sum(lengths), 3))
    run = [f"run {k}" for k, n in enumerate(lengths) for _ in range(n)]
    series = [
        delta.series_from_joints("probe", q[:2]),
        delta.series_from_joints("calliper", q, run),
    ]
    y = rng.uniform(0.01, 0.1, sum(len(s) for s in series))
    made = dataset.from_series(series, y, delta)
    path = tmp_path / "round.readings.csv"
    path.write_text(dataset.to_csv(made), "utf-8")
    again = dataset.load(path, delta)
    np.testing.assert_allclose(again.y, y, rtol=1e-14)
    for old, new in zip(made.series, again.series, strict=True):
        np.testing.assert_allclose(new.q[new.index], old.q[old.index], rtol=1e-14)
    pd.testing.assert_frame_equal(
        again.covariates.drop(columns="row"), made.covariates, check_dtype=False
    )


def test_series_of_one_set_up_keep_their_runs_apart(delta):
    q = np.full((3, 3), 0.400) + np.arange(3)[:, None] * 0.001
    twice = [
        delta.series_from_joints("calliper", q),
        delta.series_from_joints("calliper", q),
    ]
    made = dataset.from_series(twice, np.arange(4.0), delta)
    assert list(made.covariates["run"]) == ["1", "1", "1 (2)", "1 (2)"]
    assert list(made.covariates["order"]) == [2, 3, 2, 3]


def test_a_plan_to_fill_in_has_empty_readings(head, tmp_path):
    series = head.series("cup", np.array([[1.1, 0.0, 0.5]]))
    text = dataset.to_csv(dataset.from_series([series], np.array([np.nan]), head))
    assert text.splitlines()[1].endswith(",")
    assert "no reading was taken" in str(refused(text, head, tmp_path))
