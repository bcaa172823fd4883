"""The pages as HTML: one document each, its script named by digest in the policy."""

from __future__ import annotations

import json
from functools import cache
from typing import Any, Final

import jinja2

from pkm_page.guard import POLICY
from pkm_reports import text
from pkm_reports.page import page_script, script_digest, template_environment
from pkm_reports.view import within_script

#: parts of the page that are drawn anew after each reading
PARTS: Final = ("pose", "know", "decide")


def document(name: str, **values: Any) -> tuple[str, dict[str, str]]:
    """A page and its headers; `name` is that of template and script."""
    script = page_script("pkm_page", "cards.js", f"{name}.js")
    template = _environment().get_template(f"{name}.html.j2")
    policy = f"{POLICY}; script-src '{script_digest(script)}'"
    html = template.render(script=script, **values)
    return html, {"Content-Security-Policy": policy}


def parts(values: dict[str, Any]) -> dict[str, str]:
    """The parts of the measuring page that change, by the name of their element."""
    environment = _environment()
    return {
        name: environment.get_template(f"part_{name}.html.j2").render(**values)
        for name in PARTS
    }


def encoded_state(state: dict[str, Any]) -> str:
    """The state without its parts as JSON for a script element."""
    return within_script(json.dumps({k: v for k, v in state.items() if k != "parts"}))


def report_policy() -> str:
    """The policy of a stored report: only its own script runs, apart from this page."""
    return (
        "sandbox allow-scripts allow-downloads; default-src 'none'; img-src data:;"
        f" style-src 'unsafe-inline'; script-src '{script_digest()}';"
        " frame-ancestors 'none'"
    )


@cache
def _environment() -> jinja2.Environment:
    packages = [jinja2.PackageLoader(name) for name in ("pkm_page", "pkm_reports")]
    environment = template_environment(jinja2.ChoiceLoader(packages))
    environment.globals["MARKS"] = text.MARKS
    return environment
