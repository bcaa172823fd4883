"""How a program wrote a table as text: separator, decimal sign, encoding, remarks.

Spreadsheets set to German or French write semicolons and decimal commas, mark UTF-8 or
UTF-16 by a byte order mark, and leave out trailing empty cells. Python's `csv.Sniffer`
guesses the separator from letter frequencies; here the header decides, as three of its
columns are known.
"""

import codecs
import csv
import dataclasses
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from oed.dataset.columns import REQUIRED

#: separators of cells; the first is the format's own
SEPARATORS: Final = (",", ";", "\t")
#: Excel's line that names the separator; spreadsheets do not show it as a row
SEPARATOR_LINE: Final = re.compile(r"\s*\"?sep=(.)\"?[ \t]*\r?\n", re.IGNORECASE)
#: begins a line above the header that is no row
COMMENT: Final = "#"
#: columns of text for the reader alone, also numbered: `remark`, `remark_2`
REMARK: Final = re.compile(r"(remark|comment|note)s?(_\w+)?", re.IGNORECASE)
#: a number with a decimal comma
DECIMAL_COMMA: Final = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?", re.IGNORECASE)

Row = tuple[int, Sequence[str]]  #: number of a row in its file, and its cells


@dataclasses.dataclass(frozen=True, slots=True)
class SplitText:
    """Text of a readings file split into cells."""

    separator: str  #: between cells
    text: str  #: without a line that names the separator, and comments above the header
    comments: int = 0  #: number of these comments

    @classmethod
    def of(cls, text: str) -> "SplitText":
        """The table of a text. A header without the known columns counts as commas."""
        stated = SEPARATOR_LINE.match(text)
        if stated is not None and stated[1] in SEPARATORS:
            table, comments = _skip_comments(text[stated.end() :])
            return cls(stated[1], table, comments)
        table, comments = _skip_comments(text)
        header = table.lstrip().partition("\n")[0]
        for separator in SEPARATORS:
            names = {name.strip(' \t\r"') for name in header.split(separator)}
            if names.issuperset(REQUIRED):
                return cls(separator, table, comments)
        return cls(SEPARATORS[0], table, comments)

    def rows(self) -> Iterator[Row]:
        """Numbered rows that are not blank. Raises csv.Error."""
        # a StringIO would have four bytes a character
        content = io.BytesIO(self.text.encode("utf-8"))
        lines = io.TextIOWrapper(content, encoding="utf-8", newline="")
        reader = csv.reader(lines, delimiter=self.separator, strict=True)
        for number, cells in enumerate(reader, start=1 + self.comments):
            if any(cell.strip() for cell in cells):
                yield number, cells


def decode(content: bytes) -> str:
    """Text of a file in UTF-8, or UTF-16 with a mark. Raises UnicodeDecodeError."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    return content.decode("utf-8-sig")


def commented(lines: Iterable[str]) -> str:
    """The text of lines that readers skip."""
    return "".join(f"{COMMENT} {line}\n" for line in lines)


def _skip_comments(text: str) -> tuple[str, int]:
    """The text below its opening comments, and their number with blanks."""
    count, start, position, number = 0, 0, 0, 0
    while position < len(text):
        end = text.find("\n", position) + 1 or len(text)
        content = text[position:end].strip().lstrip('"')
        if content and not content.startswith(COMMENT):
            break
        position, number = end, number + 1
        if content:
            count, start = number, position
    return text[start:], count


def is_remark(name: str) -> bool:
    """Whether a column is of text for the reader alone."""
    return REMARK.fullmatch(name) is not None


def is_unread(name: str) -> bool:
    """Whether a column is a remark, or has no name at all."""
    return not name or is_remark(name)


def with_decimal_points(cells: Sequence[str], separator: str) -> list[str]:
    """Numbers with a decimal point; those with both signs stay as they are."""
    if separator == SEPARATORS[0]:
        return list(cells)
    return [c.replace(",", ".") if DECIMAL_COMMA.fullmatch(c) else c for c in cells]
