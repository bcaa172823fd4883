"""Published collections of readings, converted as they are read.

Each is an entry point `pkm_oed.sources`: a function from the collection's folder to rows of
a readings file, as text by column.
"""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from oed.text import shorten
from pkm_studies import files
from pkm_studies.base import InputError, Location, SourceAbsentError
from pkm_studies.csv_table import named_errors

MAX_BYTES = 20_000_000  #: bytes of the largest file
Row = dict[str, str]  #: cells of a row, by column
REMEDY = "take the file as published"


class PublishedFile(NamedTuple):
    """A file of a collection."""

    path: Path

    def csv_rows(self, columns: Sequence[str]) -> list[Row]:
        """Rows of a CSV file. Raises InputError where one of the columns is missing."""
        reader = csv.DictReader(io.StringIO(self._text()))
        missing = [c for c in columns if c not in (reader.fieldnames or ())]
        if missing:
            raise self.error(f"the column {missing[0]} is missing")
        with named_errors(str(self.path)):
            return [{k: cell or "" for k, cell in row.items() if k} for row in reader]

    def json_content(self) -> Any:
        """Content of a JSON file. Raises InputError."""
        try:
            return json.loads(self._text())
        except (ValueError, RecursionError) as error:
            raise self.error(f"no JSON: {shorten(str(error), 80)}") from None

    def error(self, problem: str, field: str = "") -> InputError:
        """What is wrong with the file, or with a field of it."""
        return Location(str(self.path), field).error(problem, REMEDY)

    def _text(self) -> str:
        if not self.path.is_file():
            raise SourceAbsentError(
                "the data is not there",
                "put the data there, or change readings.path",
                file=str(self.path),
            )
        return files.read_text(self.path, limit=MAX_BYTES, what="data file")
