"""The report as data: numbered blocks of plain text and rendered images.

Both writers start from it. The templates read the fields by their names.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import itertools
import re
import string
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Final

import jinja2
import markupsafe
import msgspec
import typst

from oed.result import StudyResult
from oed.safe_files import write_own
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
from pkm_reports.style import Image
from pkm_reports.view import PageView


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


DocumentBlock = Paragraph | Notice | Items | Facts | Code | TableBlock | PictureBlock


@dataclasses.dataclass(frozen=True, slots=True)
class NumberedSection:
    """A chapter with its number, or letter in the appendix; none on the first page."""

    number: str
    anchor: str
    title: str
    blocks: Sequence[DocumentBlock]


@dataclasses.dataclass(frozen=True, slots=True)
class Page:
    """All text of a report."""

    title: str
    question: str
    study: str
    machine: str
    foot: str
    answer: Sequence[NumberedSection]  #: parts of the first page
    #: chapters; those from `appendix` on belong to the appendix
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

    def html(self) -> bytes:
        """The page as UTF-8 bytes; the template engine escapes every text."""
        view = "" if self.view is None else self.view.encoded()
        page = _template().render(
            doc=self.page,
            # Without a first page there is nothing to read before the chapters.
            opened=not self.page.answer,
            images=self.images,
            view=view,
            script=_script(),
            digest=script_digest(),
        )
        return page.encode("utf-8")

    def pdf(self, *, full: bool = False) -> bytes:
        """The bytes of the PDF, of a short print or in full; the same document gives the same.

        Text reaches typst as JSON, hence as strings that it never reads as markup.
        """
        page = self.page if full else self.printed
        images = {f"{name}.svg": _svg(image) for name, image in self.images.items()}
        encoded = msgspec.json.encode(page)
        return compile_typst("report.typ", {"report.json": encoded, **images})

    def write(
        self,
        out: Path,
        name: str,
        *,
        html: bool = True,
        pdf: bool = True,
        full: bool = False,
    ) -> tuple[Path, ...]:
        """Write `NAME.html` and `NAME.pdf`, or one of them, into the folder `out`.

        The folder is created where it is missing. Files appear complete or not at all.
        One that the user changed stays, and the new one gets a number. Returns the paths,
        HTML first. Raises OSError where the folder cannot be written.
        """
        pages: dict[str, bytes] = {}
        if html:
            pages[f"{name}.html"] = self.html()
        if pdf:
            pages[f"{name}.pdf"] = self.pdf(full=full)
        out.mkdir(parents=True, exist_ok=True)
        return tuple(write_own(out / file, page) for file, page in pages.items())

    @staticmethod
    def from_result(result: StudyResult) -> Document:
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
        return Document(content, PageView.from_result(result))


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
            return dataclasses.replace(block, items=items)
        case Facts():
            rows = [(text.cleaned(term), text.cleaned(s)) for term, s in block.rows]
            return dataclasses.replace(block, rows=rows)
        case Code():
            return Code(text.cleaned(block.text).rstrip("\n"))
        case Paragraph() | Notice():
            return dataclasses.replace(block, text=text.cleaned(block.text))


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


# The report as one HTML file that loads nothing: no font, no second file.

CODE: Final = re.compile("`([^`\n]+)`")  #: a command or key within a sentence
#: parts of the script, in order
SCRIPTS: Final = ("page.js", "camera.js", "residuals.js", "view.js")


@cache
def _template() -> jinja2.Template:
    loader = jinja2.PackageLoader("pkm_reports")
    environment = jinja2.Environment(
        loader=loader,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["words"] = marked_words
    return environment.get_template("report.html.j2")


def marked_words(text: str) -> markupsafe.Markup:
    """A text escaped, with what stands between backticks as code."""
    escaped = str(markupsafe.escape(text))
    return markupsafe.Markup(CODE.sub(r"<code>\1</code>", escaped))


@cache
def _script() -> str:
    folder = resources.files("pkm_reports").joinpath("templates")
    parts = [folder.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS]
    return "\n".join(["'use strict';", *parts])


@cache
def script_digest() -> str:
    """SHA-256 of the script element's text, as a content policy states it."""
    digest = hashlib.sha256(f"\n{_script()}\n".encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


# The report as a PDF of A4 pages, set by typst.

POINTS_PER_INCH = 72.0


def compile_typst(template: str, files: Mapping[str, bytes]) -> bytes:
    """The PDF of a template and its files; the time stamp is fixed, for the same bytes."""
    folder = resources.files("pkm_reports").joinpath("templates")
    main = folder.joinpath(template).read_bytes()
    # The stubs of typst do not know that several files can be given as bytes.
    compiler: Any = typst.compile
    pages = compiler({"main.typ": main, **files}, format="pdf", timestamp=0)
    if not isinstance(pages, bytes):
        raise TypeError("typst returned no single file")
    return pages


def _svg(image: Image) -> bytes:
    """The image as SVG: typst reads only text from memory, so pixels are wrapped."""
    if image.kind == "svg":
        return image.data
    width, height = POINTS_PER_INCH * image.width, POINTS_PER_INCH * image.height
    size = f'width="{width:.1f}" height="{height:.1f}"'
    opening = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
    return f'{opening}<image {size} href="{image.uri}"/></svg>'.encode()
