"""Numbers as sentences and tables of the terminal round them."""

from __future__ import annotations

import math


def format_number(value: float) -> str:
    """Three significant digits, without an exponent in the usual range."""
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def percent_rounded_down(share: float) -> str:
    """A share in percent with one digit: 99.96 % is 99.9 %, not all."""
    return f"{math.floor(1000 * share * (1 + 1e-12)) / 10:.1f}"
