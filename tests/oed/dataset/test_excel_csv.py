"""Readings as spreadsheets save them: semicolons, decimal commas, marks, remarks."""

import codecs
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import sample

from oed.dataset import ReadingsError, table

PLAIN = sample.READINGS
GERMAN = PLAIN.replace(",", ";").replace(".", ",")


def frame(path: Path, content: bytes) -> pd.DataFrame:
    path.write_bytes(content)
    return table.read(path).frame.drop(columns=table.FILE)


def with_remarks(text: str, separator: str) -> str:
    """A remark column, an unnamed empty one, and no cells for them from row 4 on."""
    lines = text.splitlines()
    ends = ["remark", "bar warm, door open", "", None, None]
    changed = []
    for line, end in zip(lines, ends, strict=True):
        cell = "" if end is None else f'{separator}"{end}"{separator}'
        changed.append(line + cell)
    return "\r\n".join(changed) + "\r\n"


WRITTEN = {
    "semicolons": GERMAN.encode(),
    "byte order mark": codecs.BOM_UTF8 + GERMAN.encode(),
    "tabs": PLAIN.replace(",", "\t").replace(".", ",").encode(),
    "UTF-16": GERMAN.replace(";", "\t").encode("utf-16"),
    "named separator": b"sep=;\r\n" + GERMAN.replace("\n", "\r\n").encode(),
    "quoted": GERMAN.replace("300,001", '"300,001"').encode(),
    "remarks": with_remarks(GERMAN, ";").encode(),
    "remarks and commas": with_remarks(PLAIN, ",").encode(),
    "trailing cells": GERMAN.replace("\n", ";;\n").encode(),
    "points": PLAIN.replace(",", ";").encode(),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_spreadsheet_gives_the_same_readings(name, tmp_path):
    expected = frame(tmp_path / "plain.csv", PLAIN.encode())
    assert expected["length"].to_numpy()[0] == pytest.approx(0.300001)
    got = frame(tmp_path / "excel.csv", WRITTEN[name])
    pd.testing.assert_frame_equal(got, expected)


@pytest.mark.parametrize(("text", "where", "words"), [
    (GERMAN.replace("300,001", "1.300,001"), "row 2, column length_mm", "thousand"),
    (GERMAN.replace("300,001", "300,0,1"), "row 2, column length_mm", "300,0,1"),
    (PLAIN.replace("300.001", '"300,001"'), "row 2, column length_mm", "point"),
    (GERMAN.replace("300,001", "300,001;loose"), "row 2", "11 cells"),
    (GERMAN.replace(";300,001", ""), "row 2", "9 cells"),
    (GERMAN.replace("\n", ";\n").replace("300,001;", "300,001;loose"), "row 2, column", "name it in the header"),
    (GERMAN.replace("setup;", "sets;"), "row 1, column setup", "missing"),
])  # fmt: skip
def test_what_is_ambiguous_is_refused(text, where, words, tmp_path):
    path = tmp_path / "r.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ReadingsError) as error:
        table.read(path)
    assert where in str(error.value)
    assert words in str(error.value)


def test_remarks_may_be_numbered_and_are_not_read(tmp_path):
    lines = PLAIN.splitlines()
    text = "\n".join([f"{lines[0]},remark,Remark_2", *[f"{x},a,1" for x in lines[1:]]])
    got = frame(tmp_path / "r.csv", text.encode())
    assert not any("remark" in str(column).lower() for column in got.columns)
    assert np.isfinite(got["length"].to_numpy()[0])
