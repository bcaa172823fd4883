"""Cells of text that a spreadsheet would evaluate, and their way back."""

import csv
import io

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oed import csv_text

FORMULAS = [
    "=cmd|' /C calc'!A0", '=HYPERLINK("http://x")', "+1+1", "-2+3", "@SUM(A1)", "\t=1",
    "  =1", "\N{FULLWIDTH EQUALS SIGN}1",
]  # fmt: skip
NUMBERS = ["-1.5", "+2", "-1e-3", "-inf", "nan"]


@pytest.mark.parametrize("cell", FORMULAS)
def test_a_formula_is_marked_in_every_kind_of_table(cell):
    frame = pd.DataFrame({cell: [cell, "plain"], "n": [-1.5, 2.0]})
    texts = (
        csv_text.of_rows([[cell, "n"], [cell, -1.5]]),
        csv_text.of_tables([cell, "n"], [{cell: cell, "n": -1.5}]),
        csv_text.of_frame(frame),
    )
    for text in texts:
        header, row, *_ = csv.reader(io.StringIO(text, newline=""))
        assert header[0] == row[0] == f"'{cell}"
        assert row[1] == "-1.5"


@pytest.mark.parametrize("cell", [*NUMBERS, "", "a=b", "'quoted", "phi=-20deg, back 1"])
def test_numbers_and_other_texts_stay(cell):
    assert csv_text.safe(cell) == cell
    assert csv_text.plain(cell) == cell


@settings(max_examples=30)
@given(st.one_of(st.text(), st.text(alphabet="'=+-@ \tx")))
def test_marked_cells_come_back(cell):
    safe = csv_text.safe(cell)
    assert isinstance(safe, str)
    if not csv_text._is_number(cell):
        assert csv_text.plain(safe) == cell
