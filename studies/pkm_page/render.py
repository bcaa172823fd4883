"""The pages as HTML: one document each, its script named by digest in the policy."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib import resources
from typing import Any, Final

import jinja2

from pkm_page.guard import POLICY
from pkm_reports import text
from pkm_reports.view import PageView

#: scripts of the report that the page takes over, and its own
SHARED: Final = ("page.js", "camera.js", "residuals.js", "view.js")
OWN: Final = "cards.js"
#: parts of the page that are drawn anew after each reading
PARTS: Final = ("pose", "know", "decide")


def document(name: str, **values: Any) -> tuple[str, dict[str, str]]:
    """A page and its headers; `name` is that of template and script."""
    script = _script(name)
    html = (
        _environment().get_template(f"{name}.html.j2").render(script=script, **values)
    )
    digest = hashlib.sha256(f"\n{script}\n".encode()).digest()
    word = f"sha256-{base64.b64encode(digest).decode('ascii')}"
    return html, {"Content-Security-Policy": f"{POLICY}; script-src '{word}'"}


def parts(values: dict[str, Any]) -> dict[str, str]:
    """The parts of the measuring page that change, by the name of their element."""
    environment = _environment()
    return {
        name: environment.get_template(f"part_{name}.html.j2").render(**values)
        for name in PARTS
    }


def encoded(view: PageView | None) -> str:
    """The view as JSON for a script element."""
    return "null" if view is None else view.encoded()


def encoded_state(state: dict[str, Any]) -> str:
    """The state without its parts as JSON for a script element."""
    encoded = json.dumps({k: v for k, v in state.items() if k != "parts"})
    return (
        encoded.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    )


def plain(view: PageView | None) -> Any:
    """The view as plain values, to send as part of an answer."""
    return json.loads(encoded(view))


def report_policy() -> str:
    """The policy of a stored report: only its own script runs, apart from this page."""
    from pkm_reports.page import script_digest

    return (
        "sandbox allow-scripts allow-downloads; default-src 'none'; img-src data:;"
        f" style-src 'unsafe-inline'; script-src '{script_digest()}';"
        " frame-ancestors 'none'"
    )


@cache
def _environment() -> jinja2.Environment:
    templates = jinja2.PackageLoader("pkm_page")
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([templates, jinja2.PackageLoader("pkm_reports")]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["MARKS"] = text.MARKS
    return environment


@cache
def _script(name: str) -> str:
    shared = resources.files("pkm_reports").joinpath("templates")
    folder = resources.files("pkm_page").joinpath("templates")
    texts = [shared.joinpath(n).read_text(encoding="utf-8") for n in SHARED]
    texts += [
        folder.joinpath(n).read_text(encoding="utf-8") for n in (OWN, f"{name}.js")
    ]
    return "\n".join(["'use strict';", *texts])
