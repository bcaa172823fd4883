"""Rows of campaigns, and blocks of pages that tables are written into."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pkm_campaign import read_row

BEGIN, END = "<!-- begin {} -->", "<!-- end {} -->"


def rows(folder: Path) -> list[dict[str, Any]]:
    """The rows that a campaign has in its folder, whether it is done or not.

    Those without an error. Raises ValueError where there are none.
    """
    every = [read_row(path) for path in sorted((folder / "cases").glob("*.json"))]
    valid = [row for row in every if not row.get("error")]
    if not valid:
        raise ValueError(
            f"{folder}: no case; run `oed campaign benchmarks/{folder.name}.campaign.toml`"
            " first"
        )
    return valid


def write_block(page: Path, name: str, text: str) -> None:
    """Put a text between the page's marks of that name. Raises ValueError without them."""
    content = page.read_text(encoding="utf-8")
    begin, end = BEGIN.format(name), END.format(name)
    if begin not in content or end not in content:
        raise ValueError(f"{page} has no lines {begin} and {end}")
    before, _, rest = content.partition(begin)
    after = rest.partition(end)[2]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
