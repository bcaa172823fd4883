"""How good the chosen plan is: certificate, other plans beside it, other criteria,
other machines, other numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pkm_reports.blocks import Block, absent
from pkm_reports.sections.parts import (
    certificate,
    compared,
    how_many,
    plans,
    polished,
    robust,
)

ANCHOR: Final = "design"
TITLE: Final = "How good the plan is"
PARTS: Final = (certificate, polished, plans, compared, robust, how_many)


def blocks(result: Mapping[str, Any]) -> list[Block]:
    """Certificate, polishing, plans side by side, criteria compared, robustness, how
    many readings.
    """
    design = result.get("design")
    if not design:
        return absent("Choosing readings")
    return [block for part in PARTS for block in part.blocks(design)]
