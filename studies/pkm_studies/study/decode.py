"""Decodes the plain tables of a TOML file into frozen structs, with named refusals.

msgspec does the types. The walk here adds what a person needs: the path of the field,
the nearest known name, and tables that collect keys of free name (`free_keys`), such as
an instrument's settings.
"""

import math
import re
import tomllib
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from oed.text import shorten, suggest
from pkm_studies.base import NAME_PATTERN, InputError, Location
from pkm_studies.tables import TO_MEASURE

T = TypeVar("T")
#: msgspec's names of types, as words
TYPES = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}
#: patterns of the tables, as words
#: what a pattern stands for
PATTERNS = {
    NAME_PATTERN: "letters, digits, _ and - only",
    "^([A-Z][A-Z])?$": "two capitals, such as DE,",
}


def decode_table(kind: type[T], data: object, location: Location) -> T:
    """A struct of type `kind` from a table.

    Keys that the struct does not know go to its field `free_keys`, if it has one.
    Raises InputError.
    """
    if not isinstance(data, Mapping):
        remedy = f"write it as [{location.field or 'name'}] with fields below"
        raise location.error("a table is wanted here", remedy, data)
    free_keys: str | None = getattr(kind, "free_keys", None)
    fields = msgspec.structs.fields(kind)  # type: ignore[arg-type]
    known_fields = {f.encode_name: f for f in fields if f.name != free_keys}
    values: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for key, value in data.items():
        if key in known_fields:
            values[known_fields[key].name] = convert(
                known_fields[key].type, value, location.key(key)
            )
        elif free_keys is not None:
            others[key] = value
        else:
            raise location.key(key).error("unknown field", suggest(key, known_fields))
    for field in known_fields.values():
        if field.required and field.name not in values:
            raise _missing(field.encode_name, location)
    if free_keys is not None:
        declared = next(f.type for f in fields if f.name == free_keys)
        values[free_keys] = convert(declared, others, location)
    return kind(**values)


def convert(kind: Any, value: object, location: Location) -> Any:
    """A value of the annotated type: structs by `decode_table`, plain values by msgspec."""
    union = typing.get_origin(kind) in (typing.Union, types.UnionType)
    options = typing.get_args(kind) if union else (kind,)
    for option in map(_unbounded, options):
        origin, inner = typing.get_origin(option), typing.get_args(option)
        is_table = isinstance(value, Mapping)
        if _is_struct(option) and (is_table or len(options) == 1):
            return decode_table(option, value, location)
        if origin is list and _is_struct(inner[0]):
            if is_table:
                raise location.error(
                    "a list of tables is wanted",
                    f"write [[{location.field}]], with two brackets",
                )
            if isinstance(value, list):
                return [
                    decode_table(inner[0], v, location.item(i))
                    for i, v in enumerate(value)
                ]
        if origin is dict and isinstance(value, Mapping):
            converted = {}
            for key, entry in value.items():
                field = location.key(key)
                converted[_plain(inner[0], key, field)] = convert(
                    inner[1], entry, field
                )
            return converted
    return _plain(kind, value, location)


def tables_of(
    text: str, location: Location, remedy: str = "mend it there"
) -> dict[str, Any]:
    """The tables of a TOML file, each value checked. Raises InputError."""
    try:
        table = tomllib.loads(text)
        check_values(table, location)
    except ValueError as error:
        problem = f"this is no TOML: {shorten(str(error), 100)}"
        raise location.error(problem, remedy) from None
    except RecursionError:
        problem = "tables or lists are nested too deeply"
        raise location.error(problem, "write them flat") from None
    return table


def check_values(data: object, location: Location) -> None:
    """Raises InputError for values, at any depth, that are no finite number or no value yet."""
    if isinstance(data, Mapping):
        for key, value in data.items():
            check_values(value, location.key(key))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            check_values(value, location.item(i))
    elif data == TO_MEASURE:
        raise location.error(
            "a draft leaves this number open, and nothing can stand in for it",
            "measure it at your machine, and write the number in place of the words",
            data,
        )
    elif isinstance(data, int | float) and not _is_finite(data):
        raise location.error(
            "not a finite number",
            "give a number; leave the field out to use its default",
            float("inf") if isinstance(data, int) else data,
        )


def _is_finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _unbounded(kind: Any) -> Any:
    """A type without the bounds that `_plain` checks."""
    annotated = typing.get_origin(kind) is typing.Annotated
    return typing.get_args(kind)[0] if annotated else kind


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _missing(name: str, location: Location) -> InputError:
    where = f"[{location.field}]" if location.field else "the top of the file"
    remedy = f"add {name} to {where}; see `oed schema study`"
    return location.key(name).error("missing", remedy)


def _plain(kind: Any, value: object, location: Location) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
    for index in re.findall(r"\[(\d+)\]", path):
        value, location = value[int(index)], location.item(int(index))  # type: ignore[index]
    unknown = re.match(r"Invalid enum value '?([^']*)", message)
    if unknown:
        shown = unknown.group(1) if isinstance(value, dict) else value
        remedy = suggest(unknown.group(1), _choices(kind))
        raise location.error("not one of the allowed values", remedy, shown)
    raise location.error(
        _plain_message(message), "see `oed schema study` for what is allowed", value
    )


def _choices(kind: Any) -> list[str]:
    """Words that a Literal anywhere in the type allows."""
    inner = typing.get_args(kind)
    if typing.get_origin(kind) is typing.Literal:
        return [str(choice) for choice in inner]
    return [choice for part in inner for choice in _choices(part)]


def _plain_message(message: str) -> str:
    """msgspec's message in plain words.

    "Expected `float`, got `str`" becomes "a number is wanted, not text".
    """
    pattern = re.search(r"matching regex '(.*)'", message)
    if pattern:
        return f"{PATTERNS.get(pattern.group(1), pattern.group(1))} are wanted"
    if "of length" in message:
        return "a list of another length is wanted: " + message.replace("`", "")
    expected, _, got = message.partition(", got ")
    names = re.findall(r"[`|]\s*(\w+)", expected)
    wanted = " or ".join(TYPES.get(name, name) for name in names) or expected
    bound = re.search(r"([<>]=? ?-?[\d.]+)", expected)
    if bound:
        wanted += f" {bound.group(1)}"
    match = re.search(r"`(\w+)`", got)
    if match:
        return f"{wanted} is wanted, not {TYPES.get(match.group(1), match.group(1))}"
    return f"{wanted} is wanted"
