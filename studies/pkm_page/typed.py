"""A number as a person types it: read, and which slip of the hand explains a wrong one."""

import math
import re
from collections.abc import Iterator
from typing import Final

from pkm_studies.base import InputError

NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)")
MAX_ENTRY_CHARACTERS: Final = 24  #: characters of an entry


def read(text: str, field: str) -> float:
    """The number of an entry, with a decimal point or comma. Raises InputError."""
    plain = text.strip().replace("\u2212", "-")
    if len(plain) > MAX_ENTRY_CHARACTERS or NUMBER.fullmatch(plain) is None:
        raise InputError(
            "this is no number",
            "type digits with one point or comma, without unit",
            field=field,
            value=text[:MAX_ENTRY_CHARACTERS],
        )
    value = float(plain.replace(",", "."))
    if not math.isfinite(value) or abs(value) > 1e9:
        raise InputError(
            "no reading is so large", "type it again", field=field, value=text
        )
    return value


def slip(text: str, low: float, high: float) -> str | None:
    """The slip of which a number from low to high became this text; None without one.

    A digit that was left out or typed wrongly explains nearly any number that is about
    right, so these are not tried.
    """
    plain = text.strip().replace("\u2212", "-").replace(",", ".")
    for what, changed in _slips(plain):
        if (
            changed != plain
            and NUMBER.fullmatch(changed)
            and low <= float(changed) <= high
        ):
            return f"{changed} would fit: {what}"
    return None


def _slips(plain: str) -> Iterator[tuple[str, str]]:
    bare = plain.lstrip("+-")
    yield "is the sign reversed?", bare if plain.startswith("-") else f"-{bare}"
    for k in range(1, len(plain)):
        if plain[k] == plain[k - 1] and plain[k].isdigit():
            yield "was a digit typed twice?", plain[:k] + plain[k + 1 :]
    for k in range(len(plain) - 1):
        pair = plain[k : k + 2]
        if pair.isdigit():
            swapped = plain[:k] + pair[::-1] + plain[k + 2 :]
            yield "were two digits exchanged?", swapped
    digits = plain.replace(".", "")
    for k in range(1 + len(digits) - len(digits.lstrip("+-")), len(digits) + 1):
        yield (
            "is the decimal point misplaced?",
            f"{digits[:k]}.{digits[k:]}".rstrip("."),
        )
