"""The same report on A4 pages, set by typst."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

import typst

from pkm_reports.document import Document
from pkm_reports.style import Image


def render(document: Document) -> bytes:
    """The PDF's bytes.

    Words reach typst as JSON, hence as strings that it never reads as markup. The time
    stamp is fixed, for the same bytes each time.
    """
    template = (
        resources.files("pkm_reports").joinpath("templates", "report.typ").read_bytes()
    )
    words = json.dumps(document.data, ensure_ascii=False).encode("utf-8")
    files = {f"{name}.svg": _svg(image) for name, image in document.images.items()}
    compiler: Any = (
        typst.compile
    )  # its stubs do not know that several files can be given as bytes
    pages = compiler(
        {"main.typ": template, "report.json": words, **files}, format="pdf", timestamp=0
    )
    if not isinstance(pages, bytes):
        raise TypeError("typst gave no single file")
    return pages


def _svg(image: Image) -> bytes:
    """The image as SVG: typst takes only text from memory, so pixels are wrapped."""
    if image.kind == "svg":
        return image.data
    size = f'width="{72.0 * image.width:.1f}" height="{72.0 * image.height:.1f}"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}><image {size}'
        f' href="{image.uri}"/></svg>'.encode()
    )
