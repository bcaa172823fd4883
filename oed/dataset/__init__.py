"""Readings as taken, with their poses and covariates; their CSV files read and written.

DECIMAL_COMMA     a number with a decimal comma
Dataset           readings in SI: series, values and covariates
MAX_BYTES         size of a readings file, at most
MAX_NUMBER        size of a number in a cell, at most
ReadingsColumn    a column of a readings file: its name, stem, unit and factor
ReadingsError     readings that cannot be used: file, row, column and remedy
Row               a row of the only file, or of one of several
SEXAGESIMAL       angles whose decimals are minutes, or minutes and seconds
SIGMA             how columns of standard deviations begin
SplitText         text of a readings file, split into cells
UNITLESS          columns without a unit in their name
WRONG_FACTORS     what a value is over what it should be, in words
column_meanings   other meanings that a column of poses may have
commented         lines that readers skip
count_rows        number of rows of a file, which is checked
decode            text of a file in UTF-8, or in UTF-16 with a mark
expected_columns  SI unit of every stem that a column may have
from_rows         the dataset of rows of text
from_series       the dataset of planned series
is_counted        whether readings are of the same session
is_remark         whether a column is for the reader alone
load              the dataset of a file, or of several
load_sessions     the dataset of several sessions
named_rows        the row of each reading, with its file
reading_digests   digests of readings, by which they are known again
shared            share of readings that two sets have in common
temperature_body  the body that a column is the temperature of
tension_columns   stems of the tensions of a machine's cables
to_csv            the text of a readings file
written           an SI value as it is written in a file
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.dataset.columns import (
        SEXAGESIMAL,
        SIGMA,
        UNITLESS,
        WRONG_FACTORS,
        ReadingsColumn,
        column_meanings,
        expected_columns,
        temperature_body,
        tension_columns,
        written,
    )
    from oed.dataset.csv_input import from_rows, load, load_sessions
    from oed.dataset.data import (
        Dataset,
        Row,
        from_series,
        is_counted,
        named_rows,
        reading_digests,
        shared,
        to_csv,
    )
    from oed.dataset.dialect import (
        DECIMAL_COMMA,
        SplitText,
        commented,
        decode,
        is_remark,
    )
    from oed.dataset.readings_file import ReadingsError
    from oed.dataset.table import MAX_BYTES, MAX_NUMBER, count_rows
else:
    # imported when first used: names of columns need no table of readings
    __getattr__ = door(__name__)
