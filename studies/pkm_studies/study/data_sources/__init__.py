"""Published collections of readings, converted as they are read.

Each is an entry point `pkm_oed.sources`: a function from the collection's folder to rows of
a readings file, as text by column.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from oed.text import shorten
from pkm_studies import files
from pkm_studies.base import Location, SourceAbsentError
from pkm_studies.csv_table import named_errors

#: bytes of the largest file
MAX_BYTES = 20_000_000
#: cells of a row, by column
Row = dict[str, str]
AS_PUBLISHED = "take the file as published"


def read_csv(path: Path, columns: Sequence[str]) -> list[Row]:
    """Rows of a CSV file. Raises InputError where one of the columns is missing."""
    reader = csv.DictReader(io.StringIO(_text(path)))
    missing = [c for c in columns if c not in (reader.fieldnames or ())]
    if missing:
        problem = f"the column {missing[0]} is missing"
        raise Location(str(path)).error(problem, AS_PUBLISHED)
    with named_errors(str(path)):
        return [{key: cell or "" for key, cell in row.items() if key} for row in reader]


def read_json(path: Path) -> Any:
    """Content of a JSON file. Raises InputError."""
    try:
        return json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        problem = f"no JSON: {shorten(str(error), 80)}"
        raise Location(str(path)).error(problem, AS_PUBLISHED) from None


def _text(path: Path) -> str:
    if not path.is_file():
        raise SourceAbsentError(
            "the data is not there",
            "put the data there, or change readings.path",
            file=str(path),
        )
    return files.read_text(path, limit=MAX_BYTES, what="data file")
