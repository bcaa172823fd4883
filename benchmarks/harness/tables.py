"""Lines of Markdown tables."""

from __future__ import annotations


def head(*names: str) -> str:
    """Heading of a table, with the line below it."""
    return f"{row(*names)}\n{'|---' * len(names)}|"


def row(*cells: object) -> str:
    """One line of a table."""
    return f"| {' | '.join(map(str, cells))} |"
