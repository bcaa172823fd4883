"""Contradictions within a result, and the comparisons that find them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec

from oed.base import units
from oed.base.text import shorten, suggest

#: size of a number beyond which it is a slip, and its square overflows soon
LARGEST: Final = 1e100
#: logarithms of which a power can be taken
LARGEST_LOGARITHM: Final = 700.0
#: units beside those of `oed.base.units`
OTHER_UNITS: Final = ("", "1", "sigma", "readings", "s", "K", "m", "rad")
#: names of fields that hold a unit, or units by name
UNITS_OF: Final = ("unit", "units", "spots_unit")


class Breach(NamedTuple):
    """A field that contradicts another, and how."""

    field: str
    problem: str


def value_breaches(field: str, value: Any) -> Iterator[Breach]:
    """Numbers and units anywhere within a value that no result has."""
    if isinstance(value, msgspec.Struct):
        value = {name: getattr(value, name) for name in value.__struct_fields__}
    if isinstance(value, Mapping):
        for key, entry in value.items():
            at = _join(field, str(key))
            if key in UNITS_OF:
                yield from _unit_breaches(at, entry)
            yield from value_breaches(at, entry)
    elif isinstance(value, list | tuple):
        for k, entry in enumerate(value, start=1):
            yield from value_breaches(f"{field}[{k}]", entry)
    elif isinstance(value, int | float) and not abs(value) < LARGEST:
        yield Breach(field, f"{value:.3g} is no number of a result")


def _unit_breaches(field: str, value: Any) -> Iterator[Breach]:
    """A unit, or units by name, that nobody knows."""
    if isinstance(value, str):
        yield from unit(field, value)
    elif isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _unit_breaches(_join(field, str(name)), entry)


def _join(field: str, name: str) -> str:
    return f"{field}.{name}" if field else name


def lengths(
    field: str, values: Sequence[Any], other: str, count: int
) -> Iterator[Breach]:
    """A list whose length differs from a number that `other` states."""
    if len(values) != count:
        yield Breach(field, f"{len(values)} entries, where {other} has {count}")


def table(
    field: str, rows: Sequence[Sequence[Any]], other: str, height: int, width: int
) -> Iterator[Breach]:
    """A table that is not of the height and width that `other` states."""
    yield from lengths(field, rows, other, height)
    for k, row in enumerate(rows, start=1):
        yield from lengths(f"{field}[{k}]", row, other, width)


def points(field: str, places: Sequence[Sequence[float]]) -> Iterator[Breach]:
    """Points that have not three coordinates."""
    for k, place in enumerate(places, start=1):
        yield from lengths(f"{field}[{k}]", place, "a point", 3)


def known(
    field: str, names: Collection[str], allowed: Collection[str], of: str
) -> Iterator[Breach]:
    """Names that `of` does not have."""
    for name in names:
        if name not in allowed:
            remedy = suggest(name, allowed, kind=of, limit=12)
            yield Breach(field, f"{shorten(name, 40)!r} is not in {of}; {remedy}")
            return


def same_names(
    field: str, names: Collection[str], others: Collection[str], of: str
) -> Iterator[Breach]:
    """Names that are not exactly those of `of`."""
    yield from known(field, names, others, of)
    for name in others:
        if name not in names:
            yield Breach(field, f"{shorten(name, 40)!r} is missing, which {of} has")
            return


def same_keys(field: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[Breach]:
    """Rows by name that have other names than the first."""
    for k, row in enumerate(rows[1:], start=2):
        yield from same_names(f"{field}[{k}]", row, rows[0], f"{field}[1]")


def same_commands(field: str, rows: Sequence[Mapping[str, Any]]) -> Iterator[Breach]:
    """Commands that have other names than the first; empty where joints were recorded."""
    known_rows = [(k, row) for k, row in enumerate(rows, start=1) if row]
    for k, row in known_rows[1:]:
        first, names = known_rows[0]
        yield from same_names(f"{field}[{k}]", row, names, f"{field}[{first}]")


def unit(field: str, name: str) -> Iterator[Breach]:
    """A unit that nobody knows: no product of known ones, with their powers."""
    of_effects = [shown for shown, _ in units.EFFECT.values()]
    known = {*units.UNITS, *OTHER_UNITS, *of_effects}
    factors = name.replace("/", " ").split()
    if not all(factor in known or factor.rstrip("23") in known for factor in factors):
        yield Breach(field, f"{shorten(name, 40)!r} is no known unit")


def within(field: str, value: float, low: float, high: float) -> Iterator[Breach]:
    """A number outside of its range."""
    if not low <= value <= high:
        ends = f"{low:g} on" if math.isinf(high) else f"{low:g} to {high:g}"
        yield Breach(field, f"{value:.6g} is not from {ends}")


def ascending(field: str, values: Sequence[float]) -> Iterator[Breach]:
    """Numbers that do not grow, or do not begin above zero."""
    for k, value in enumerate(values, start=1):
        if value <= (values[k - 2] if k > 1 else 0):
            yield Breach(f"{field}[{k}]", f"{value:g} is not above the one before")
            return
