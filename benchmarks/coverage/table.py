"""The table of a campaign, as Markdown, and its place in a page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from benchmarks.coverage.cell import Cell, Share

BEGIN, END = "<!-- begin {} -->", "<!-- end {} -->"
HEAD = (
    "| readings | noise | machines | combinations: mean | worst | pose bands: mean |"
    " worst | NEES/n |"
)


def markdown(cells: Mapping[tuple[str, str], Cell]) -> str:
    """One row a cell; what misses its target is bold, or italic where it may hold."""
    lines = [HEAD, "| --- | --- | --: | --: | --: | --: | --: | --: |"]
    lines += [_row(name, law, cell) for (name, law), cell in cells.items()]
    return "\n".join(lines)


def _row(name: str, law: str, cell: Cell) -> str:
    nees = _mark(
        f"{cell.nees:.2f} ± {cell.nees_half:.2f}", cell.nees_holds, cell.nees_may_hold
    )
    columns = [
        name,
        law,
        str(cell.machines),
        *_columns(cell.combinations),
        *_columns(cell.bands),
        nees,
    ]
    return f"| {' | '.join(columns)} |"


def _columns(share: Share) -> list[str]:
    mean = _mark(
        f"{share.mean:.3f} ± {share.half:.3f}", share.mean_holds, share.mean_may_hold
    )
    worst = _mark(f"{share.worst:.2f} ({share.lowest:.2f})", share.worst_holds, False)
    return [mean, worst]


def _mark(text: str, holds: bool, may_hold: bool) -> str:
    if holds:
        return text
    return f"*{text}*" if may_hold else f"**{text}**"


def write_block(page: Path, name: str, text: str) -> None:
    """Put a text between the page's marks of that name. Raises ValueError without them."""
    content = page.read_text(encoding="utf-8")
    begin, end = BEGIN.format(name), END.format(name)
    if begin not in content or end not in content:
        raise ValueError(f"{page} has no lines {begin} and {end}")
    before, _, rest = content.partition(begin)
    after = rest.partition(end)[2]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
