"""Numbers told as text: sensible digits, units a person writes, lists in words."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, Final

from oed import units

MISSING: Final = "–"
MINUS: Final = "\N{MINUS SIGN}"
#: no line break between a number and its unit
GAP: Final = "\N{NO-BREAK SPACE}"
SUPERSCRIPT: Final = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
PRETTY: Final = {"um": "µm", "urad": "µrad", "deg": "°", "C": "°C", "1": ""}


def number(value: Any) -> float:
    """A float; null, text and absent entries become NaN."""
    return (
        float(value)
        if isinstance(value, (int, float)) and not isinstance(value, bool)
        else math.nan
    )


def num(value: Any, digits: int = 3) -> str:
    """A number with `digits` significant digits; very large and very small ones as
    powers of ten.
    """
    x = number(value)
    if not math.isfinite(x):
        return MISSING if math.isnan(x) else ("∞" if x > 0 else f"{MINUS}∞")
    if x == 0.0:
        return "0"
    if not 1e-4 <= abs(x) < 1e6:
        return _power(x, digits)
    if x == round(x):
        return _signed(f"{x:.0f}")
    # Decimals follow the rounded number: 9.996 has one more digit before the point than
    # it seems.
    decimals = max(
        0, digits - 1 - math.floor(math.log10(abs(float(f"{x:.{digits - 1}e}"))))
    )
    return _signed(f"{x:.{decimals}f}")


def plain(value: Any, digits: int = 4) -> str:
    """As `num`, without zeros at the end: 0.5, not 0.5000."""
    text = num(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "×" not in text else text


def _power(x: float, digits: int) -> str:
    mantissa, _, exponent = f"{x:.{digits - 1}e}".partition("e")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    power = f"10{str(int(exponent)).translate(SUPERSCRIPT)}"
    return power if mantissa == "1" else f"{_signed(mantissa)}×{power}"


def _signed(text: str) -> str:
    return text.replace("-", MINUS)


def decimals_of(sd: Any) -> int:
    """Decimals that show two significant digits of a standard deviation."""
    x = number(sd)
    return (
        min(9, max(0, 1 - math.floor(math.log10(x))))
        if math.isfinite(x) and x > 0.0
        else 3
    )


def fixed(value: Any, decimals: int) -> str:
    """A number with so many decimals."""
    x = number(value)
    if not math.isfinite(x) or (x != 0.0 and abs(x) >= 1e9):
        return num(x)
    text = f"{x:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else _signed(text)


def column(values: Sequence[Any], most: int = 4, digits: int = 7) -> list[str]:
    """Numbers of one column with one number of decimals: as few as show them all to
    `digits` digits.
    """
    known = [abs(number(v)) for v in values if math.isfinite(number(v))]
    largest = max(known, default=0.0)
    room = (
        max(0, min(most, digits - 1 - math.floor(math.log10(largest))))
        if largest > 0
        else 0
    )
    texts = [f"{v:.{room}f}".partition(".")[2].rstrip("0") for v in known]
    decimals = max((len(text) for text in texts), default=0)
    return [fixed(v, decimals) for v in values]


def unit(name: str) -> str:
    """The unit as a person writes it: um -> µm."""
    return PRETTY.get(name, name)


def quantity(value: Any, name: str, digits: int = 3) -> str:
    """A number with its unit, never parted by a line break."""
    return with_unit(num(value, digits), name)


def with_unit(text: str, name: str) -> str:
    """Digits with their unit; a degree sign stands close, as it should."""
    sign = unit(name)
    return text + (sign if sign == "°" else f"{GAP}{sign}" if sign else "")


def percent(share: Any) -> str:
    """A share between 0 and 1 as percent: whole ones, one decimal above 99 and below 1."""
    x = 100.0 * number(share)
    if math.isnan(x):
        return MISSING
    near_an_end = 0.0 < x < 1.0 or 99.0 < x < 100.0
    return f"{fixed(x, 1 if near_an_end else 0)}{GAP}%"


def certain(share: Any) -> str:
    """A guaranteed share as percent with one decimal, never rounded up: 99.96 % is not
    all.
    """
    x = number(share)
    return (
        f"{fixed(math.floor(1000.0 * x * (1.0 + 1e-12)) / 10.0, 1)}{GAP}%"
        if math.isfinite(x)
        else MISSING
    )


def factor(ratio: Any) -> str:
    """How many times as good: 3.05×."""
    x = number(ratio)
    return f"{num(x)}×" if math.isfinite(x) else MISSING


def parted(name: str) -> tuple[str, str]:
    """Stem and unit of a field name, the unit empty where there is none: z_um -> z, um."""
    try:
        stem, suffix = units.split(name)
    except units.UnitError:
        stem, suffix = str(name), ""
    return stem.replace("_", " "), suffix


def heading(name: str) -> str:
    """A column title from a field name: z_mm -> z [mm]."""
    stem, suffix = parted(name)
    sign = unit(suffix)
    return f"{stem} [{sign}]" if sign else stem


def labelled(name: str, value: Any, digits: int = 5) -> str:
    """A named number from a field: length_mm, 300 -> length 300 mm."""
    stem, suffix = parted(name)
    return f"{stem}{GAP}{with_unit(plain(value, digits), suffix)}"


def numbers(fields: dict[str, Any], digits: int = 5) -> str:
    """Named numbers in one line."""
    return (
        ", ".join(labelled(name, value, digits) for name, value in fields.items())
        or MISSING
    )


def count(n: int, noun: str) -> str:
    """1 reading, 2 readings."""
    return f"{n}{GAP}{noun if n == 1 else noun + 's'}"


def listing(items: Iterable[str], most: int = 12) -> str:
    """a, b and c; a long list is cut, and says so."""
    names = [str(item) for item in items]
    if len(names) > most:
        names = [*names[:most], f"{len(names) - most} more"]
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(text: str) -> str:
    """The text as a sentence: a capital where it starts with a plain word, and a full
    stop.
    """
    text = pretty(text).strip()
    first = text.partition(" ")[0]
    text = (
        text[:1].upper() + text[1:]
        if first.isalpha() and first.islower() and len(first) > 1
        else text
    )
    return text if not text or text[-1] in ".!?:" else f"{text}."


def pretty(text: str) -> str:
    """Text of the study with 5 um written 5 µm, as everywhere in the report."""
    return re.sub(r"(?<=\d) um\b", f"{GAP}µm", str(text))


def cut(text: str, longest: int = 70) -> str:
    """Text of at most so many signs."""
    return text if len(text) <= longest else f"{text[: longest - 1].rstrip()}…"


def combination(terms: dict[str, Any], most: int = 10) -> str:
    """A linear combination, its largest term first: 0.71 db2x − 0.71 db3x."""
    ordered = sorted(terms.items(), key=lambda term: -abs(number(term[1])))
    text = ""
    for k, (name, value) in enumerate(ordered[:most]):
        x = number(value)
        sign = (
            (MINUS if x < 0 else "") if k == 0 else (f" {MINUS} " if x < 0 else " + ")
        )
        size = plain(abs(x), 2)
        text += f"{sign}{'' if size == '1' else size + GAP}{name}"
    return text + (
        f" + {len(ordered) - most} smaller terms" if len(ordered) > most else ""
    )
