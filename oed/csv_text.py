"""CSV text that is safe to open in a spreadsheet: no cell of text is a formula.

A spreadsheet evaluates cells that begin with =, +, - or @. Texts of a user that do get an
apostrophe in front, which the readings' reader takes away again; numbers stay.
"""

from __future__ import annotations

import csv
import io
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import pandas as pd

#: how a formula begins, also behind blanks that a spreadsheet may drop
FORMULA_STARTS: Final = ("=", "+", "-", "@", "\t", "\r", "\n")
TEXT_MARK: Final = "'"


def safe(cell: object) -> object:
    """A cell as it may stand in a file: a text that would be a formula is marked."""
    if isinstance(cell, str) and _is_formula(cell) and not _is_number(cell):
        return TEXT_MARK + cell
    return cell


def plain(cell: str) -> str:
    """The text that `safe` marked."""
    return cell[1:] if cell.startswith(TEXT_MARK) and _is_formula(cell) else cell


def of_rows(rows: Iterable[Sequence[object]]) -> str:
    """The text of rows of cells, the header first."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([safe(cell) for cell in row] for row in rows)
    return text.getvalue()


def of_tables(header: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """The text of rows by column; a cell that a row does not have is empty."""
    return of_rows([header, *([row.get(name, "") for name in header] for row in rows)])


def of_frame(frame: pd.DataFrame) -> str:
    """The text of a table of pandas, without its index."""
    safe_cells: Any = frame.rename(columns=safe).map(safe)
    text: str = safe_cells.to_csv(index=False, lineterminator="\n")
    return text


def _is_formula(cell: str) -> bool:
    """Whether a text begins as a formula does, once its marks are gone."""
    # some spreadsheets take the wide signs of Japanese and Chinese as well
    return (
        unicodedata.normalize("NFKC", cell.lstrip(TEXT_MARK)[:8])
        .lstrip(" ")
        .startswith(FORMULA_STARTS)
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
