"""The report as one HTML file that loads nothing: no script, no font, no second file."""

from __future__ import annotations

from functools import cache

import jinja2

from pkm_reports.document import Document


def render(document: Document) -> bytes:
    """The page as UTF-8 bytes; the template engine escapes every text."""
    page = _template().render(doc=document.page, images=document.images)
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
    return environment.get_template("report.html.j2")
