"""Readings as taken, with their poses and covariates; their CSV files read and written.

A file has one row a reading: `setup`, `run`, `order`; the commanded pose, one column a
coordinate (`z_mm`), or the recorded joints (`q1_mm`); covariates; and the instrument's
channels (`length_mm`). The first row of a run is the reference of instruments that
compare two poses. An empty reading was not taken. Files are checked before use, and
refused with row, column and remedy.

columns     columns of a file and their names
table       text of a file as a table of checked cells
checks      a table against the machine and its set-ups
data        the readings of a session in SI
csv_input   readings from files
sessions    tables of several sessions as those of one
csv_output  readings to files
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.dataset.csv_input import from_tables, load, load_sessions
    from oed.dataset.csv_output import to_csv
    from oed.dataset.data import ColumnLayout, Dataset, from_series
    from oed.dataset.readings_file import ReadingsError
else:
    # imported when first used: names of columns need no table of readings
    __getattr__ = door(__name__)
