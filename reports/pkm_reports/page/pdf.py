"""The report as a PDF of A4 pages, set by typst."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from typing import Any

import msgspec
import typst

from pkm_reports.page.document import Document
from pkm_reports.style import Image

POINTS_PER_INCH = 72.0


def render_pdf(document: Document, *, full: bool = False) -> bytes:
    """The bytes of the PDF, of a short print or in full; the same document gives the same.

    Text reaches typst as JSON, hence as strings that it never reads as markup.
    """
    page = document.page if full else document.printed
    images = {f"{name}.svg": _svg(image) for name, image in document.images.items()}
    encoded = msgspec.json.encode(page)
    return compile_typst("report.typ", {"report.json": encoded, **images})


def compile_typst(template: str, files: Mapping[str, bytes]) -> bytes:
    """The PDF of a template of this package with the files that it reads.

    The time stamp is fixed, so that the same input gives the same bytes.
    """
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
