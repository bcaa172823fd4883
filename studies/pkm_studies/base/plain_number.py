"""A number as machines and instruments write it: not all that Python takes for one."""

from __future__ import annotations

import re

PLAIN = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def plain_number(text: str) -> float | None:
    """The value of a decimal number; None for other text.

    Underscores, digits of other scripts, `nan` and `inf` are none. The value may be
    infinite where the exponent is.
    """
    stripped = text.strip()
    return float(stripped) if PLAIN.fullmatch(stripped) else None
