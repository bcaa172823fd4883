"""The report as one HTML file that loads nothing: no font, no second file.

Its script is part of the file; the content policy names its digest, so that no other
script runs, whatever a study's texts hold.
"""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from importlib import resources
from typing import Final

import jinja2
import markupsafe

from pkm_reports.page.document import Document
from pkm_reports.view import encoded_view

#: a command or key within a sentence
CODE: Final = re.compile("`([^`\n]+)`")
#: parts of the script, in order
SCRIPTS: Final = ("page.js", "camera.js", "residuals.js", "view.js")


def render_html(document: Document) -> bytes:
    """The page as UTF-8 bytes; the template engine escapes every text."""
    view = "" if document.view is None else encoded_view(document.view)
    page = _template().render(
        doc=document.page,
        # Without a first page there is nothing to read before the chapters.
        opened=not document.page.answer,
        images=document.images,
        view=view,
        script=_script(),
        digest=script_digest(),
    )
    return page.encode("utf-8")


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
