"""Numbers, units, lists and sentences as text of a report."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from oed import text as toolkit_text
from oed import units
from oed.result import Judgement
from pkm_reports.missing import column, finite, or_nan

MISSING: Final = "–"
#: a verdict as a cell, and the mark of its row
VERDICTS: Final[dict[Judgement, str]] = {
    "pass": "✓ pass",
    "fail": "✗ fail",
    "cannot tell": "? cannot tell",
}
MARKS: Final[dict[Judgement, str]] = {
    "pass": "good",
    "fail": "bad",
    "cannot tell": "chosen",
}
MINUS: Final = "\N{MINUS SIGN}"
NO_BREAK: Final = "\N{NO-BREAK SPACE}"  #: no line breaks between a number and its unit
#: the space between a number and its unit in a sentence
BEFORE_UNIT: Final = re.compile(rf"(?<=\d) (?=%|(?:{'|'.join(units.UNITS)})\b)")
SUPERSCRIPT: Final = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
SYMBOLS: Final = {"um": "µm", "urad": "µrad", "deg": "°", "C": "°C", "1": ""}
#: control characters that neither HTML nor typst can show
INVISIBLE: Final = {
    code: "\N{REPLACEMENT CHARACTER}"
    for code in (*range(9), 11, 12, *range(14, 32), 127)
}
SMALLEST = 1e-4  #: size from which a number is written without a power of ten
LARGEST = 1e6  #: size up to which it is
#: size from which a number with given decimals gets a power of ten all the same
TOO_LONG: Final = 1e9
MAX_DECIMALS: Final = 9


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits, or with a power of ten."""
    x = or_nan(value)
    if math.isnan(x):
        return MISSING
    if math.isinf(x):
        return "∞" if x > 0 else f"{MINUS}∞"
    if x == 0.0:
        return "0"
    if not SMALLEST <= abs(x) < LARGEST:
        return _power_of_ten(x, digits)
    if x == round(x):
        return _minus_sign(f"{x:.0f}")
    # 9.996 rounds to 10.0: the decimals follow the rounded number.
    rounded = abs(float(f"{x:.{digits - 1}e}"))
    decimals = max(0, digits - 1 - math.floor(math.log10(rounded)))
    return _minus_sign(f"{x:.{decimals}f}")


def drawn(value: float | None, error: float | None, digits: int = 3) -> str:
    """A number of draws, its standard error at most three units of the last digit."""
    x, e = or_nan(value), or_nan(error)
    if not math.isfinite(x) or not math.isfinite(e) or e <= 0.0 or x == 0.0:
        return number(value, digits)
    last_decimal = last_place(e)
    x = round(x, -last_decimal)
    if x == 0.0:
        return "0"
    allowed = math.floor(math.log10(abs(x))) - last_decimal + 1
    return number(x, min(digits, max(allowed, 1)))


def last_place(error: float) -> int:
    """Power of ten of the last digit that a standard error leaves."""
    return round(math.log10(error))


def trimmed(value: float | None, digits: int = 4) -> str:
    """As `number`, without zeros at the end: 0.5, not 0.5000."""
    written = number(value, digits)
    if "." not in written or "×" in written:
        return written
    return written.rstrip("0").rstrip(".")


def fixed(value: float | None, decimals: int) -> str:
    """A number with so many decimals."""
    x = or_nan(value)
    if not math.isfinite(x) or abs(x) >= TOO_LONG:
        return number(x)
    written = f"{x:.{decimals}f}"
    if float(written) == 0.0:
        return written.lstrip("-")
    return _minus_sign(written)


def aligned(values: Iterable[float | None], most: int = 4) -> list[str]:
    """Numbers of one column, all with as many decimals as show them to seven digits."""
    numbers = [or_nan(value) for value in values]
    sizes = [abs(x) for x in finite(numbers)]
    largest = max(sizes, default=0.0)
    room = 0
    if largest > 0.0:
        before_point = math.floor(math.log10(largest))
        room = max(0, min(most, 6 - before_point))
    fractions = [f"{x:.{room}f}".partition(".")[2].rstrip("0") for x in sizes]
    decimals = max(map(len, fractions), default=0)
    return [fixed(x, decimals) for x in numbers]


def aligned_columns(
    rows: Sequence[Mapping[str, float | None]], most: int = 4
) -> dict[str, list[str]]:
    """The numbers of each name that any row has, as `aligned`."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: aligned(column(rows, name), most) for name in names}


def decimals_for(sd: float | None) -> int:
    """Decimals that show two significant digits of a standard deviation."""
    x = or_nan(sd)
    if not math.isfinite(x) or x <= 0.0:
        return 3
    return min(MAX_DECIMALS, max(0, 1 - math.floor(math.log10(x))))


def _power_of_ten(x: float, digits: int) -> str:
    mantissa, _, exponent = f"{x:.{digits - 1}e}".partition("e")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    power = f"10{str(int(exponent)).translate(SUPERSCRIPT)}"
    return power if mantissa == "1" else f"{_minus_sign(mantissa)}×{power}"


def _minus_sign(written: str) -> str:
    return written.replace("-", MINUS)


# -- shares and ratios -----------------------------------------------------------------
def percent(share: float | None) -> str:
    """A share as percent, with its missing value and signs as in all numbers."""
    x = or_nan(share)
    if not math.isfinite(x):
        return number(x)
    written = toolkit_text.percent(x)
    if written == "-0 %":
        written = "0 %"
    return _minus_sign(written).replace(" %", f"{NO_BREAK}%")


def percent_at_least(share: float | None) -> str:
    """A guaranteed share as percent, never rounded up: 99.96 % is not all."""
    x = or_nan(share)
    if not math.isfinite(x):
        return MISSING
    return f"{fixed(toolkit_text.guaranteed_percent(x), 1)}{NO_BREAK}%"


def percent_at_most(share: float) -> str:
    """A guaranteed loss as percent, never rounded down."""
    tenths = math.ceil(1000.0 * share - 1e-9)
    return f"{fixed(tenths / 10.0, 1)}{NO_BREAK}%"


def factor_at_most(factor: float) -> str:
    """A guaranteed factor with one decimal, never rounded down."""
    tenths = math.ceil(10.0 * factor - 1e-9)
    return fixed(tenths / 10.0, 1)


def times(ratio: float | None) -> str:
    """How many times as good: 3.05×."""
    x = or_nan(ratio)
    return f"{number(x)}×" if math.isfinite(x) else MISSING


def unit_symbol(unit: str) -> str:
    """The unit as a person writes it: um -> µm."""
    return meaning(unit, SYMBOLS)


def quantity(value: float | None, unit: str, digits: int = 3) -> str:
    """A number with its unit, without a line break between them."""
    return append_unit(number(value, digits), unit)


def append_unit(digits: str, unit: str) -> str:
    """Digits with their unit; a degree sign follows without a space."""
    symbol = unit_symbol(unit)
    if not symbol or symbol == "°":
        return f"{digits}{symbol}"
    return f"{digits}{NO_BREAK}{symbol}"


def split_unit(name: str) -> tuple[str, str]:
    """Stem and unit of a field name, the unit empty where it has none: z_um -> z, um."""
    try:
        stem, unit = units.split(name)
    except units.UnitError:
        stem = name
        unit = ""
    return stem.replace("_", " "), unit


def heading(name: str) -> str:
    """A column title from a field name: z_mm -> z [mm]."""
    stem, unit = split_unit(name)
    symbol = unit_symbol(unit)
    return f"{stem} [{symbol}]" if symbol else stem


def named_quantity(name: str, value: float | None, digits: int = 5) -> str:
    """A named number from a field: length_mm, 300 -> length 300 mm."""
    stem, unit = split_unit(name)
    return f"{stem}{NO_BREAK}{append_unit(trimmed(value, digits), unit)}"


def named_quantities(fields: Mapping[str, float | None], digits: int = 5) -> str:
    """Named numbers in one line."""
    parts = [named_quantity(name, value, digits) for name, value in fields.items()]
    return ", ".join(parts) or MISSING


def channel_value(
    channel: str, value: float | None, channel_units: Mapping[str, str]
) -> str:
    """A number with the unit of its channel."""
    return quantity(value, channel_units.get(channel, ""))


def replace_symbols(phrase: str) -> str:
    """Text of a study with 5 um written as 5 µm, and no line break before a unit."""
    bound = BEFORE_UNIT.sub(NO_BREAK, phrase)
    return re.sub(rf"(?<=\d{NO_BREAK})um\b", "µm", bound)


def meaning(word: str, meanings: Mapping[str, str]) -> str:
    """What a word of result.json means; the word itself where it is not known."""
    return meanings.get(word, word)


def count(n: int, noun: str) -> str:
    """1 reading, 2 readings."""
    return f"{n}{NO_BREAK}{noun if n == 1 else noun + 's'}"


def listing(items: Iterable[str], most: int = 12) -> str:
    """a, b and c; a long list ends in how many more there are."""
    names = list(items)
    if len(names) > most:
        names = [*names[:most], f"{len(names) - most} more"]
    return toolkit_text.join_words(names)


def plain(phrase: str) -> str:
    """A phrase without typographic spaces and signs, for a terminal."""
    return phrase.replace(NO_BREAK, " ").replace(MINUS, "-").replace("µ", "u")


def cleaned(phrase: str) -> str:
    """Text without control characters and lone surrogates."""
    visible = phrase.translate(INVISIBLE)
    decodable = visible.encode("utf-8", "replace").decode("utf-8")
    return decodable.replace("\r\n", "\n")


def sentence(phrase: str) -> str:
    """A sentence: a capital where it starts with a plain word, and a full stop."""
    phrase = add_full_stop(phrase)
    first = phrase.partition(" ")[0]
    is_plain = len(first) > 1 or first == "a"
    if is_plain and first.isalpha() and first.islower():
        phrase = phrase[:1].upper() + phrase[1:]
    return phrase


def add_full_stop(phrase: str) -> str:
    """Text of a study, ended by a full stop."""
    phrase = replace_symbols(phrase).strip()
    if not phrase or phrase[-1] in ".!?:":
        return phrase
    return f"{phrase}."


def sentences(texts: Iterable[str]) -> list[str]:
    """Each text as a sentence."""
    return [sentence(phrase) for phrase in texts]


def linear_combination(terms: Mapping[str, float], most: int = 10) -> str:
    """A linear combination, its largest term first: 0.71 db2x − 0.71 db3x."""
    # equal terms stay in their order: which is larger by rounding says nothing
    ordered = sorted(terms.items(), key=lambda term: -float(f"{abs(term[1]):.6g}"))
    written = ""
    for k, (name, coefficient) in enumerate(ordered[:most]):
        size = trimmed(abs(coefficient), 2)
        factor = "" if size == "1" else f"{size}{NO_BREAK}"
        written += f"{_sign(coefficient, first=k == 0)}{factor}{name}"
    if len(ordered) > most:
        written += f" + {len(ordered) - most} smaller terms"
    return written


def _sign(coefficient: float, *, first: bool) -> str:
    if first:
        return MINUS if coefficient < 0.0 else ""
    return f" {MINUS} " if coefficient < 0.0 else " + "
