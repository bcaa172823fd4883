"""From a decoded result to report.html and report.pdf."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pkm_reports import document, html, pdf


def write_report(result: Mapping[str, Any], out: Path) -> tuple[Path, Path]:
    """Writes `report.html` and `report.pdf` into the folder `out` (made if it is not there).

    `result` is the mapping decoded from result.json. Both files are complete or not there: they are written under
    another name first. Returns their paths, HTML first. Raises OSError where the folder cannot be written.
    """
    made = document.build(result)
    pages = {"report.html": html.render(made), "report.pdf": pdf.render(made)}
    out.mkdir(parents=True, exist_ok=True)
    first, second = (_whole(out / name, data) for name, data in pages.items())
    return first, second


def _whole(path: Path, data: bytes) -> Path:
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path
