"""Words of messages: numbers, shares in percent, texts shortened, names suggested."""

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Final

PERCENT_ROUNDING: Final = 1e-9  #: percent by which rounding may miss all of something
MAX_WORD_LENGTH: Final = 30  #: length from which `shorten` cuts within a word


def rounded(value: float, digits: int = 2) -> str:
    """A number to so many digits, without an exponent below a million: 1200."""
    return f"{float(f'{value:.{digits}g}'):g}"


def format_number(value: float) -> str:
    """Three significant digits, without an exponent in the usual range."""
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def percent(share: float) -> str:
    """A share between 0 and 1 in percent, such as `83 %` or `99.6 %`.

    One decimal below 1 % and above 99 %. What is neither nothing nor all is never
    rounded to 0 % or 100 %.
    """
    value = 100.0 * share
    if 0.0 < value < 0.05:
        return "under 0.1 %"
    if 99.95 <= value < 100.0 - PERCENT_ROUNDING:
        return "over 99.9 %"
    near_an_end = 0.0 < value < 1.0 or 99.0 < value < 100.0 - PERCENT_ROUNDING
    return f"{value:.{1 if near_an_end else 0}f} %"


def format_probability(p: float) -> str:
    """A probability in percent as draws support it; 0 % and 100 % only where exact."""
    if 0.99 < p < 1.0:
        return "over 99 %"
    return "under 1 %" if 0.0 < p < 0.01 else f"{100.0 * p:.0f} %"


def format_p_value(p: float) -> str:
    """A p-value in one digit: tails are not known beyond nine decades."""
    return "< 1e-9" if p < 1e-9 else f"{p:.1g}"


def guaranteed_percent(share: float) -> float:
    """A guaranteed share in percent, rounded down to one decimal: 99.96 % is not all."""
    return math.floor(1000.0 * share * (1.0 + 1e-12)) / 10.0


def shorten(text: str, length: int) -> str:
    """Text on one line, printable, of at most `length` characters."""
    printable = (c if c.isprintable() else " " for c in text[: 4 * length])
    line = " ".join("".join(printable).split())
    if len(line) <= length:
        return line
    cut = line[: length - 4]
    head, _, part = cut.rpartition(" ")
    if head and len(part) < MAX_WORD_LENGTH and line[length - 4] != " ":
        cut = head
    return f"{cut.rstrip()} ..."


def suggest(
    word: str, allowed: Iterable[str], kind: str = "allowed", limit: int | None = None
) -> str:
    """Remedy for an unknown name: the nearest, and a list of `limit` at most."""
    names = list(dict.fromkeys(allowed))
    if not names:
        return f"nothing is {kind} here: remove it"
    listing = f"{kind}: {', '.join(names[:limit])}"
    if limit is not None and len(names) > limit:
        listing += ", ..."
    nearest = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    return f"did you mean {nearest[0]}? ({listing})" if nearest else listing


def capitalised(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def join_words(names: Sequence[str], last: str = "and") -> str:
    """a, b and c."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"
