"""Paragraphs, lists, facts, tables and pictures: what a report is made of, for HTML and PDF.

All text is plain. No block holds markup, so no name in a study can become markup; each
writer escapes what it writes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, ClassVar, Final

from oed.result import StudyResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS: Final = ("", "good", "bad", "chosen")  #: what a row of a table can be marked as


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
class Facts:
    """Named facts: a term and what is to be said of it, row by row."""

    kind: ClassVar[str] = "facts"
    rows: Sequence[tuple[str, str]]


@dataclasses.dataclass(frozen=True, slots=True)
class Code:
    """Text as typed."""

    kind: ClassVar[str] = "code"
    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class TableColumn:
    """The heading of a column and how the column is set."""

    title: str
    number: bool = False  #: right-aligned, never wrapped
    wide: bool = False  #: takes the width that the other columns leave

    @classmethod
    def texts(cls, *titles: str) -> list[TableColumn]:
        """Columns of words."""
        return [cls(title) for title in titles]

    @classmethod
    def numbers(cls, *titles: str) -> list[TableColumn]:
        """Columns of numbers."""
        return [cls(title, number=True) for title in titles]


@dataclasses.dataclass(frozen=True, slots=True)
class Table:
    """Cells as text, row by row."""

    kind: ClassVar[str] = "table"
    columns: Sequence[TableColumn]
    rows: Sequence[Sequence[str]]
    caption: str
    marks: Sequence[str] = ()  #: the meaning of each row (see MARKS), or empty
    #: whether the rows are the readings of the drawing, in its order
    linked: bool = False

    def mark(self, row: int) -> str:
        """Mark of a row."""
        return self.marks[row] if self.marks else ""


@dataclasses.dataclass(frozen=True, slots=True)
class Picture:
    """A figure and its caption; the figure is drawn when the report is written."""

    kind: ClassVar[str] = "picture"
    name: str
    draw: Callable[[], Figure]
    caption: str


Block = Paragraph | Notice | Items | Facts | Code | Table | Picture


@dataclasses.dataclass(frozen=True, slots=True)
class Section:
    """A chapter of one report, with its content.

    printed    what a short print has of it; all of it where None
    """

    anchor: str
    title: str
    blocks: Sequence[Block]
    printed: Sequence[Block] | None = None


@dataclasses.dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter that a report can have: where it links to, and what fills it.

    A chapter that applies to nothing in the result has no blocks, and is not shown.
    Most chapters are for the screen: `printed` gives what a short print has of one.
    """

    anchor: str
    title: str
    blocks: Callable[[StudyResult], list[Block]]
    printed: Callable[[StudyResult], list[Block]] = lambda _: []

    def section(self, result: StudyResult) -> Section:
        """The chapter of one result."""
        blocks = self.blocks(result)
        printed = self.printed(result) if blocks else []
        return Section(self.anchor, self.title, blocks, printed)


def transposed(columns: Sequence[Sequence[str]]) -> list[list[str]]:
    """Rows from columns."""
    return [list(row) for row in zip(*columns, strict=True)]


def headed_list(heading: str, items: Sequence[str]) -> list[Block]:
    """A list below its heading; nothing where there are no items."""
    return [Paragraph(heading), Items(items)] if items else []
