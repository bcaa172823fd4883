"""Rows of several files: each is named with its file, and no two are the same."""

from pathlib import Path

import blunder_machines as machines
import pandas as pd
import pytest
import sample

from oed import checks, dataset
from oed.checks import sentences
from oed.checks.copies import EqualReadings
from oed.checks.session import SessionReadings
from oed.dataset.data import short_names


def of_two_files(tmp_path: Path) -> SessionReadings:
    """The same readings in two files, with runs of other names in the second."""
    measurement = sample.resolved().measurement
    paths = [tmp_path / "first.csv", tmp_path / "later.csv"]
    later = sample.READINGS.replace(",low,", ",low2,").replace(",high,", ",high2,")
    for path, text in zip(paths, (sample.READINGS, later), strict=True):
        path.write_text(text, encoding="utf-8")
    data = dataset.load(paths, measurement)
    return checks.session_readings(
        measurement, data.series, data.y, data.covariates, data.columns
    )


def test_a_row_of_several_files_is_named_with_its_file(tmp_path):
    session = of_two_files(tmp_path)
    rows = session.rows(range(6))
    assert [int(row) for row in rows] == [2, 3, 5, 2, 3, 5]
    assert len(set(rows)) == 6
    finding = sentences.doubled(session, [EqualReadings((0, 3), same_pose=True)])
    assert "rows 2 of first.csv and 2 of later.csv." in finding.sentence
    assert "row 3 of later.csv, column" in sentences._place(session, 4)


def test_rows_of_the_only_file_are_numbers():
    session = machines.session("a3", machines.readings("a3", 2))
    rows = session.rows([3, 4])
    assert all(isinstance(row, int) for row in rows)
    assert pd.api.types.is_integer_dtype(session.values["row"])


@pytest.mark.parametrize(("files", "names"), [
    (["a/one.csv", "b/two.csv"], ["one.csv", "two.csv"]),
    (["a/one.csv", "b/one.csv"], ["a/one.csv", "b/one.csv"]),
    (["a\\one.csv", "two.csv"], ["one.csv", "two.csv"]),
])  # fmt: skip
def test_files_go_by_their_names_where_these_differ(files, names):
    assert short_names(files) == names
