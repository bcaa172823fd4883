"""What a report is made of: sections of paragraphs, lists, tables and pictures, told
once for HTML and PDF.

All text is plain. No block holds markup, so nothing in a study's names can become
markup; each writer escapes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar, Final

from matplotlib.figure import Figure

#: what a row of a table can be marked as
MARKS: Final = ("", "good", "bad", "chosen")


@dataclasses.dataclass(frozen=True, slots=True)
class Paragraph:
    """Running text."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class Notice:
    """A sentence that must not be overlooked."""

    kind: ClassVar[str] = "notice"
    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class Items:
    """A list, numbered or not."""

    kind: ClassVar[str] = "items"
    items: Sequence[str]
    numbered: bool = False


@dataclasses.dataclass(frozen=True, slots=True)
class Code:
    """Text as typed."""

    kind: ClassVar[str] = "code"
    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class TableColumn:
    """A column: numbers stand right and never wrap, words stand left; `wide` ones take
    the room that is left.
    """

    title: str
    number: bool = False
    wide: bool = False


@dataclasses.dataclass(frozen=True, slots=True)
class Table:
    """Cells as text, one row a line; `marks` gives each row its meaning (see MARKS)."""

    kind: ClassVar[str] = "table"
    columns: Sequence[TableColumn]
    rows: Sequence[Sequence[str]]
    caption: str
    marks: Sequence[str] = ()

    def mark(self, row: int) -> str:
        """Mark of a row."""
        return self.marks[row] if self.marks else ""


@dataclasses.dataclass(frozen=True, slots=True)
class Picture:
    """A figure and what one sees in it; drawn when the report is written."""

    kind: ClassVar[str] = "picture"
    name: str
    draw: Callable[[], Figure]
    caption: str


Block = Paragraph | Notice | Items | Code | Table | Picture


@dataclasses.dataclass(frozen=True, slots=True)
class Section:
    """A chapter of the report."""

    anchor: str
    title: str
    blocks: Sequence[Block]


def text_column(*titles: str) -> list[TableColumn]:
    """Columns of words."""
    return [TableColumn(title) for title in titles]


def number_column(*titles: str) -> list[TableColumn]:
    """Columns of numbers."""
    return [TableColumn(title, number=True) for title in titles]


def transposed(columns: Sequence[Sequence[str]]) -> list[list[str]]:
    """Rows from columns."""
    return [list(row) for row in zip(*columns, strict=True)]


def absent(what: str) -> list[Block]:
    """The one sentence for a stage that did not run."""
    return [Paragraph(f"{what} was not part of this study.")]
