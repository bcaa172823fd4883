"""The report as data: numbered blocks of plain text and rendered images.

Both writers start from it. The templates read the fields by their names.
"""

from __future__ import annotations

import dataclasses
import itertools
import string
from collections.abc import Iterator, Sequence
from functools import cached_property

from oed.result import StudyResult
from pkm_reports import sections, style, text
from pkm_reports.blocks import (
    Block,
    Code,
    Facts,
    Items,
    Notice,
    Paragraph,
    Picture,
    Section,
    Table,
    TableColumn,
)
from pkm_reports.view import PageView, build_view


@dataclasses.dataclass(frozen=True, slots=True)
class TextBlock:
    """A paragraph, a notice, or text as typed."""

    kind: str
    text: str


@dataclasses.dataclass(frozen=True, slots=True)
class ItemsBlock:
    """A list."""

    kind: str
    items: Sequence[str]
    numbered: bool


@dataclasses.dataclass(frozen=True, slots=True)
class Fact:
    """A term and what is said of it."""

    term: str
    words: str


@dataclasses.dataclass(frozen=True, slots=True)
class FactsBlock:
    """A list of facts."""

    kind: str
    rows: Sequence[Fact]


@dataclasses.dataclass(frozen=True, slots=True)
class TableRow:
    """The cells of a row and what it is marked as."""

    mark: str
    cells: Sequence[str]


@dataclasses.dataclass(frozen=True, slots=True)
class TableBlock:
    """A numbered table; rows of a linked one are the readings of the views."""

    kind: str
    label: str
    caption: str
    columns: Sequence[TableColumn]
    rows: Sequence[TableRow]
    linked: bool


@dataclasses.dataclass(frozen=True, slots=True)
class PictureBlock:
    """A numbered figure; its image is in the document under `name`.

    width, height    inches
    """

    kind: str
    label: str
    caption: str
    name: str
    file: str
    width: float
    height: float


DocumentBlock = TextBlock | ItemsBlock | FactsBlock | TableBlock | PictureBlock


@dataclasses.dataclass(frozen=True, slots=True)
class NumberedSection:
    """A chapter with its number, or letter in the appendix; none on the first page."""

    number: str
    anchor: str
    title: str
    blocks: Sequence[DocumentBlock]


@dataclasses.dataclass(frozen=True, slots=True)
class Page:
    """All text of a report.

    answer     parts of the first page
    sections   chapters; those from `appendix` on belong to the appendix
    """

    title: str
    question: str
    study: str
    machine: str
    foot: str
    answer: Sequence[NumberedSection]
    sections: Sequence[NumberedSection]
    appendix: int


@dataclasses.dataclass(frozen=True, slots=True)
class Numbering:
    """Running numbers of figures and tables, and the images drawn so far."""

    images: dict[str, style.Image]
    figures: Iterator[int] = dataclasses.field(
        default_factory=lambda: itertools.count(1)
    )
    tables: Iterator[int] = dataclasses.field(
        default_factory=lambda: itertools.count(1)
    )


@dataclasses.dataclass(frozen=True, slots=True)
class Content:
    """What a report holds, before it is numbered and drawn.

    study, machine    for file names and the page's edge
    answer            parts of the first page
    """

    title: str
    question: str
    study: str
    machine: str
    foot: str
    answer: Sequence[Section]
    chapters: Sequence[Section]
    appendix: Sequence[Section]


@dataclasses.dataclass(frozen=True)
class Document:
    """A content with its blocks numbered, and its pictures drawn for who asks first.

    images     those drawn so far, by name
    view       what turns on the screen
    """

    content: Content
    view: PageView | None = None
    images: dict[str, style.Image] = dataclasses.field(default_factory=dict)

    @cached_property
    def page(self) -> Page:
        """All of it, for the screen."""
        return _page(self.content, Numbering(self.images))

    @cached_property
    def printed(self) -> Page:
        """What a short print has."""
        return _page(_printed(self.content), Numbering(self.images))


def build_document(result: StudyResult) -> Document:
    """All text, tables and pictures of a result."""
    content = Content(
        title=result.title or result.study,
        question=result.question,
        study=result.study,
        machine=result.machine.name,
        foot=footer(result),
        answer=sections.answer_parts(result),
        chapters=sections.chapters(result),
        appendix=sections.appendix(result),
    )
    return Document(content, build_view(result))


def _page(content: Content, numbering: Numbering) -> Page:
    with style.applied():
        parts = [_chapter("", part, numbering) for part in content.answer]
        numbered = [
            _chapter(number, section, numbering)
            for number, section in (
                *zip(map(str, itertools.count(1)), content.chapters, strict=False),
                *zip(string.ascii_uppercase, content.appendix, strict=False),
            )
        ]
    return Page(
        title=text.cleaned(content.title),
        question=text.cleaned(content.question),
        study=text.cleaned(content.study),
        machine=text.cleaned(content.machine),
        foot=text.cleaned(content.foot),
        answer=parts,
        sections=numbered,
        appendix=len(content.chapters),
    )


def _printed(content: Content) -> Content:
    """What a short print has of a report; it names the chapters that it leaves out."""
    chapters, absent = [], []
    for section in (*content.chapters, *content.appendix):
        if section.printed is None:
            chapters.append(section)
        elif section.printed:
            chapters.append(dataclasses.replace(section, blocks=section.printed))
        if section.printed is not None and section.printed != section.blocks:
            absent.append(section.title)
    if absent:
        words = (
            f"report.html has the whole of these: {text.listing(absent, len(absent))}."
        )
        chapters.append(Section("more", "More on the screen", [Paragraph(words)]))
    return dataclasses.replace(content, chapters=chapters, appendix=[])


def footer(result: StudyResult) -> str:
    """Study, seed and version, for the foot of each page."""
    return f"{result.study} · seed {result.seed} · pkm-oed {result.version}"


def _chapter(number: str, section: Section, numbering: Numbering) -> NumberedSection:
    blocks = [_block(block, numbering) for block in section.blocks]
    return NumberedSection(number, section.anchor, section.title, blocks)


def _block(block: Block, numbering: Numbering) -> DocumentBlock:
    """One block for the writers; pictures are drawn here."""
    match block:
        case Table():
            return _table(block, next(numbering.tables))
        case Picture():
            image = numbering.images.get(block.name) or drawn_image(block)
            numbering.images[block.name] = image
            return _picture(block, next(numbering.figures), image)
        case Items():
            items = [text.cleaned(item) for item in block.items]
            return ItemsBlock(block.kind, items, block.numbered)
        case Facts():
            rows = [
                Fact(text.cleaned(term), text.cleaned(phrase))
                for term, phrase in block.rows
            ]
            return FactsBlock(block.kind, rows)
        case Code():
            return TextBlock(block.kind, text.cleaned(block.text).rstrip("\n"))
        case Paragraph() | Notice():
            return TextBlock(block.kind, text.cleaned(block.text))


def drawn_image(picture: Picture) -> style.Image:
    """The figure of a picture, drawn and written."""
    return style.render(picture.draw())


def _table(table: Table, number: int) -> TableBlock:
    columns = [
        dataclasses.replace(c, title=text.cleaned(c.title)) for c in table.columns
    ]
    rows = [
        TableRow(table.mark(k), [text.cleaned(cell) for cell in row])
        for k, row in enumerate(table.rows)
    ]
    caption = text.cleaned(table.caption)
    return TableBlock(
        table.kind, f"Table {number}", caption, columns, rows, table.linked
    )


def _picture(picture: Picture, number: int, image: style.Image) -> PictureBlock:
    return PictureBlock(
        kind=picture.kind,
        label=f"Figure {number}",
        caption=text.cleaned(picture.caption),
        name=picture.name,
        file=f"{picture.name}.svg",
        width=float(image.width),
        height=float(image.height),
    )
