"""From a decoded result to report.html and report.pdf."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pkm_reports import document
from pkm_reports import html as to_html
from pkm_reports import pdf as to_pdf


def write_report(
    result: Mapping[str, Any], out: Path, *, html: bool = True, pdf: bool = True
) -> tuple[Path, ...]:
    """Writes `report.html` and `report.pdf`, or one of them, into the folder `out`
    (made if it is not there).

    `result` is the mapping decoded from result.json. Files are complete or not there:
    they are written under another name first. Returns their paths, HTML first. Raises
    OSError where the folder cannot be written.
    """
    made = document.build(result)
    wanted = [("report.html", to_html.render)] * html + [
        ("report.pdf", to_pdf.render)
    ] * pdf
    pages = {name: render(made) for name, render in wanted}
    out.mkdir(parents=True, exist_ok=True)
    return tuple(_whole(out / name, data) for name, data in pages.items())


def _whole(path: Path, data: bytes) -> Path:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path
