"""The report as plain values: numbered blocks of text and rendered images.

Both writers start from it. The templates read the keys by their names.
"""

from __future__ import annotations

import base64
import collections
import dataclasses
import hashlib
import itertools
import re
import string
from collections.abc import Mapping, Sequence
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
from pkm_reports.blocks import Block, Code, Paragraph, Picture, Section, Table
from pkm_reports.style import Image
from pkm_reports.view import PageView


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
    def page(self) -> dict[str, Any]:
        """All of it, for the screen."""
        return _page(self.content, self.images)

    @cached_property
    def printed(self) -> dict[str, Any]:
        """What a short print has."""
        return _page(_printed(self.content), self.images)

    def html(self) -> bytes:
        """The page as UTF-8 bytes; the template engine escapes every text."""
        view = "" if self.view is None else self.view.encoded()
        page = _template().render(
            doc=self.page,
            # Without a first page there is nothing to read before the chapters.
            opened=not self.page["answer"],
            images=self.images,
            view=view,
            script=page_script(),
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


def _page(content: Content, images: dict[str, style.Image]) -> dict[str, Any]:
    """The content as plain values, its blocks numbered; draws what `images` lacks."""
    numbers = collections.Counter[str]()
    numbered = [
        *zip(map(str, itertools.count(1)), content.chapters, strict=False),
        *zip(string.ascii_uppercase, content.appendix, strict=False),
    ]
    with style.applied():
        page = {
            "title": content.title,
            "question": content.question,
            "study": content.study,
            "machine": content.machine,
            "foot": content.foot,
            "answer": [_chapter("", part, numbers, images) for part in content.answer],
            "sections": [_chapter(n, part, numbers, images) for n, part in numbered],
            # chapters from this one on belong to the appendix
            "appendix": len(content.chapters),
        }
    return {key: cleaned_values(value) for key, value in page.items()}


def _chapter(
    number: str,
    section: Section,
    numbers: collections.Counter[str],
    images: dict[str, style.Image],
) -> dict[str, Any]:
    """A chapter with its number, or letter in the appendix; none on the first page."""
    return {
        "number": number,
        "anchor": section.anchor,
        "title": section.title,
        "blocks": [_block(block, numbers, images) for block in section.blocks],
    }


def _block(
    block: Block, numbers: collections.Counter[str], images: dict[str, style.Image]
) -> dict[str, Any]:
    """One block for the writers; pictures are drawn here."""
    names = [field.name for field in dataclasses.fields(block)]
    values = {"kind": block.kind} | {name: getattr(block, name) for name in names}
    if isinstance(block, Code):
        values["text"] = text.cleaned(block.text).rstrip("\n")
    if isinstance(block, Table):
        numbers["Table"] += 1
        values["label"] = f"Table {numbers['Table']}"
        values["columns"] = [dataclasses.asdict(column) for column in block.columns]
        values["rows"] = [
            {"mark": block.mark(k), "cells": cells}
            for k, cells in enumerate(block.rows)
        ]
    if isinstance(block, Picture):
        numbers["Figure"] += 1
        values["label"] = f"Figure {numbers['Figure']}"
        image = images.get(block.name) or drawn_image(block)
        images[block.name] = image
        size = {"width": float(image.width), "height": float(image.height)}
        del values["draw"]
        values |= {"file": f"{block.name}.svg", **size}  # inches
    return values


def cleaned_values(value: Any) -> Any:
    """Nested values whose texts have no control characters."""
    if isinstance(value, str):
        return text.cleaned(value)
    if isinstance(value, Mapping):
        return {key: cleaned_values(entry) for key, entry in value.items()}
    if isinstance(value, Sequence):
        return [cleaned_values(entry) for entry in value]
    return value


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


def drawn_image(picture: Picture) -> style.Image:
    """The figure of a picture, drawn and written."""
    return style.render(picture.draw())


# The report as one HTML file that loads nothing: no font, no second file.

CODE: Final = re.compile("`([^`\n]+)`")  #: a command or key within a sentence
#: parts of the script, in order
SCRIPTS: Final = ("page.js", "camera.js", "residuals.js", "view.js")


def template_environment(loader: jinja2.BaseLoader) -> jinja2.Environment:
    """Templates that escape every text, and name no value that they are not given."""
    environment = jinja2.Environment(
        loader=loader,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["words"] = marked_words
    return environment


@cache
def _template() -> jinja2.Template:
    environment = template_environment(jinja2.PackageLoader("pkm_reports"))
    return environment.get_template("report.html.j2")


def marked_words(text: str) -> markupsafe.Markup:
    """A text escaped, with what stands between backticks as code."""
    escaped = str(markupsafe.escape(text))
    return markupsafe.Markup(CODE.sub(r"<code>\1</code>", escaped))


@cache
def page_script(package: str = "", *names: str) -> str:
    """The script of a report, with files of a further package's templates below it."""
    parts = [*(("pkm_reports", n) for n in SCRIPTS), *((package, n) for n in names)]
    texts = [
        resources.files(owner).joinpath("templates", name).read_text(encoding="utf-8")
        for owner, name in parts
    ]
    return "\n".join(["'use strict';", *texts])


@cache
def script_digest(script: str | None = None) -> str:
    """SHA-256 of a script element's text, the report's or another, for a content policy."""
    written = page_script() if script is None else script
    digest = hashlib.sha256(f"\n{written}\n".encode()).digest()
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
