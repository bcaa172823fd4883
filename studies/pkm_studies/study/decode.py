"""From the plain tables of a TOML file to frozen structs; every refusal names its
field.

msgspec does the types; the walk here adds what a person needs: the path of the field,
the nearest known name, and tables that keep fields of their own (`rest`), such as an
instrument's settings.
"""

from __future__ import annotations

import math
import re
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from pkm_studies.errors import InputError, Place, suggest

T = TypeVar("T")
WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}
#: patterns used in studies, in words
PATTERNS = {"^[A-Za-z0-9][A-Za-z0-9_-]*$": "letters, digits, _ and - only"}


def decode(kind: type[T], data: object, place: Place) -> T:
    """A struct of type `kind` from a table; fields unknown to it go to its field named
    by `rest`, if it has one.
    """
    if not isinstance(data, Mapping):
        raise place.error(
            "a table is wanted here",
            f"write it as [{place.field or 'name'}] with fields below",
            data,
        )
    rest: str | None = getattr(kind, "rest", None)
    fields = msgspec.structs.fields(kind)  # type: ignore[arg-type]
    known = {f.encode_name: f for f in fields if f.name != rest}
    values: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for key, value in data.items():
        if key in known:
            values[known[key].name] = convert(known[key].type, value, place.key(key))
        elif rest is not None:
            others[key] = value
        else:
            raise place.key(key).error("unknown field", suggest(key, known))
    missing = [f for f in known.values() if f.required and f.name not in values]
    if missing:
        raise _absent(missing[0].encode_name, place)
    if rest is not None:
        declared = next(f.type for f in fields if f.name == rest)
        values[rest] = convert(declared, others, place)
    return kind(**values)


def convert(kind: Any, value: object, place: Place) -> Any:
    """A value of the annotated type `kind`: structs and containers of structs by
    `decode`, the rest by msgspec.
    """
    options = (
        typing.get_args(kind)
        if typing.get_origin(kind) in (typing.Union, types.UnionType)
        else (kind,)
    )
    for option in map(_bare, options):
        origin, inner = typing.get_origin(option), typing.get_args(option)
        if _is_struct(option) and (isinstance(value, Mapping) or len(options) == 1):
            return decode(option, value, place)
        if origin is list and isinstance(value, Mapping) and _is_struct(inner[0]):
            raise place.error(
                "a list of tables is wanted",
                f"write [[{place.field}]], with two brackets",
            )
        if origin is list and isinstance(value, list) and _is_struct(inner[0]):
            return [decode(inner[0], v, place.item(i)) for i, v in enumerate(value)]
        if origin is dict and isinstance(value, Mapping):
            return {
                _plain(inner[0], k, place.key(k)): convert(inner[1], v, place.key(k))
                for k, v in value.items()
            }
    return _plain(kind, value, place)


def finite(data: object, place: Place) -> None:
    """Refuse nan, inf and numbers beyond floating point anywhere below `place`."""
    if isinstance(data, Mapping):
        for key, value in data.items():
            finite(value, place.key(key))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            finite(value, place.item(i))
    elif isinstance(data, int | float) and not _sound(data):
        raise place.error(
            "not a finite number",
            "give a number; leave the field out to use its default",
            float("inf") if isinstance(data, int) else data,
        )


def _sound(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _bare(kind: Any) -> Any:
    """A type without its bounds, for which `_plain` cares."""
    return (
        typing.get_args(kind)[0]
        if typing.get_origin(kind) is typing.Annotated
        else kind
    )


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _absent(name: str, place: Place) -> InputError:
    where = f"[{place.field}]" if place.field else "the top of the file"
    return place.key(name).error(
        "missing", f"add {name} to {where}; see `oed schema study`"
    )


def _plain(kind: Any, value: object, place: Place) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        what, _, path = str(error).partition(" - at `$")
    for index in re.findall(r"\[(\d+)\]", path):
        value, place = value[int(index)], place.item(int(index))  # type: ignore[index]
    choices = [] if path.strip("`") else _choices(kind)
    if choices and isinstance(value, str):
        raise place.error(
            "not one of the allowed values", suggest(value, choices), value
        )
    raise place.error(
        _worded(what), "see `oed schema study` for what is allowed", value
    )


def _choices(kind: Any) -> list[str]:
    """Words that a Literal anywhere in the type allows."""
    inner = typing.get_args(kind)
    if typing.get_origin(kind) is typing.Literal:
        return [str(c) for c in inner]
    return [c for k in inner for c in _choices(k)]


def _worded(message: str) -> str:
    """msgspec's message in words: "Expected `float`, got `str`" -> "a number is wanted,
    not text".
    """
    pattern = re.search(r"matching regex '(.*)'", message)
    if pattern:
        return f"{PATTERNS.get(pattern.group(1), pattern.group(1))} are wanted"
    if "of length" in message:
        return "a list of another length is wanted: " + message.replace("`", "")
    expected, _, got = message.partition(", got ")
    wanted = (
        " or ".join(WORDS.get(w, w) for w in re.findall(r"[`|]\s*(\w+)", expected))
        or expected
    )
    bound = re.search(r"([<>]=? ?-?[\d.]+)", expected)
    found = re.search(r"`(\w+)`", got)
    tail = f", not {WORDS.get(found.group(1), found.group(1))}" if found else ""
    return f"{wanted}{' ' + bound.group(1) if bound else ''} is wanted{tail}"
