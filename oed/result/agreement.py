"""What must agree within a result: names, lengths, numbers and units.

Types and ranges are those of the records. A file that was edited, cut or merged may still
contradict itself; then a report of it would be wrong, or fail half-way.
"""

import functools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec

from oed import units
from oed.result.study import StudyResult
from oed.text import shorten, suggest

#: size of a number beyond which it is a slip, and its square overflows soon
MAX_NUMBER: Final = 1e100
#: units beside those of `oed.units`
OTHER_UNITS: Final = ("", "1", "sigma", "readings", "s", "K", "m", "rad")
#: names of fields that hold a unit, or units by name
UNIT_FIELDS: Final = ("unit", "units", "spots_unit")

PREDICTIONS: Final = (
    "{prediction,corrected/prediction,gap/mixture/prediction,gap/mixture/with_effects}"
)
TABLES: Final = "gap_before/{table,chosen/table}"
#: A field, a relation and what it is to, a line each. `{a,b}` stands for either name, `*`
#: for each entry, `#` for all entries together, `..` for what a field lies in; a field
#: with `?` may be empty.
RULES: Final = f"""
{{identifiability,identifiability_of/*}}/parameters length ../n
kappa_maps/*/kappa length ../circles
kappa_maps/*/kappa/* length ../../points
design/robust/{{values,nominal_values}} length ../scenarios
design/how_many/{{accuracy,bound}}/* length ../../sizes
drawing/{{reading_of,runs?,commands?}} length ../tool_points
{{estimate,corrected}}/covariance? length ../parameters
gap/mixture/covariance length ../parameters
{{estimate,corrected,gap/mixture}}/covariance/* length ../../parameters
estimate/{{residuals,residuals_before}} length ../channels
{{estimate/runs,after_compensation}}/*/{{measured,predicted,half_widths}} length ../at
{{estimate/runs,after_compensation}}/*/{{compensated?,compensated_half_widths?}} length ../at
{{estimate/runs,after_compensation}}/*/compensated length ../compensated_half_widths
posterior/corner/* length ../../directions
corrected/tables/*/table length ../values
corrected/tables/*/table/* length ../../commands
corrected/tables/*/table/*/* length ../../../joints
held_out/*/{{residuals,half_widths}} length ../n
{PREDICTIONS}/map/*/at length ../../0/at
gap/traces/*/{{before,explained,unexplained,after}} length ../at
{TABLES}/{{apart,angles_deg}} length ../names
{TABLES}/{{apart,angles_deg}}/* length ../../names
adjustment/accuracy one_more ../lines

{{identifiability,identifiability_of/*}}/rank at_most ../singular_values
{{identifiability,identifiability_of/*}}/singular_values at_most ../n
drawing/bars at_most ../tool_points
gap/{{answers,set95}}/*/classes at_most ../effects

{{identifiability,identifiability_of/*}}/{{combinations,lost}}/* among ../../parameters
design/poses/*/setup among setups/#/name?
design/compared/*/values among ../../#/name
design/how_many/{{wanted,bound}} among ../accuracy
plan/{{accuracy,goal,best_reachable}} among ../start_accuracy?
plan/stages/*/accuracy among ../../../start_accuracy?
plan/compared/*/gain among ../plan/accuracy
drawing/reading_of among setups/#/name?
estimate/{{channels,rms_before,rms_after}} among ../units
estimate/combinations/*/terms among ../../../parameters
{{estimate,corrected,gap/mixture}}/controller among ../parameters
corrected/rms_after among ../units
corrected/effects/*/effect among ../../../constants
{PREDICTIONS}/{{wanted,worst,realised,realised_share}} among ../components
{PREDICTIONS}/budget/predicted among ../../components
{PREDICTIONS}/budget/usual/{{unmodelled,fitted}} among ../../predicted
verification/positioning among ../components
gap/selected among ../tried?
gap/sizes/*/effect among ../../../selected
gap/coefficients/*/effect among ../../../selected
gap/{{rms_before,rms_after}} among ../units
{TABLES}/names among ../effects/#/name
{TABLES}/{{classes,absorbed,exact}}/* among ../../effects/#/name
{TABLES}/effects/*/{{signature,least,median}} among gap_before/units

{{estimate,gap}}/rms_after names ../rms_before
estimate/commands/* names ../#
{PREDICTIONS}/unit names ../components
{PREDICTIONS}/references/* names ../../components
{PREDICTIONS}/tools/*/components names ../../../components
{PREDICTIONS}/{{map,worst}}/*/{{before,after}} names ../../../components
drawing/commands/*? names ../#
{PREDICTIONS}/map/*/command names ../../#/command
{PREDICTIONS}/components/*/{{before,after,known}}/unit among ../../../../unit/#
{PREDICTIONS}/budget/lines/*/{{share,size,without,halved}} names ../../../predicted
{PREDICTIONS}/budget/unmodelled/*/{{size,with_it,far?}} names ../../../predicted
corrected/parameters_only names ../prediction/components
corrected/tables/*/commands/* names ../#
gap/mixture/choices/*/rms names ../../../prediction/components
gap/sizes/*/rms names ../../../units
gap_before/chosen/runs/*/condition names ../../#/condition
adjustment/accuracy/*/{{corrected,plain}} names ../../../unit
acceptance/poses/* names ../#
forecast/nodes/* names ../#
"""


#: steps of a pattern that stand for each entry, or for all of them together
EVERY: Final = ("*", "#")
Keys = tuple[str, ...]  #: keys from the whole result on, and what is there
Entry = tuple[Keys, Any]


class Breach(NamedTuple):
    """A field that contradicts another, and how."""

    field: str
    problem: str


class _Reference:
    """What a rule compares with: all entries of one table have the same."""

    def __init__(self, values: list[Any]) -> None:
        self.values = values

    @functools.cached_property
    def names(self) -> Collection[str]:
        return _names(self.values)


def breaches(result: StudyResult) -> Iterator[Breach]:
    """Contradictions within a result, by field; none where all fits."""
    tree = msgspec.to_builtins(result)

    @functools.cache
    def reference(steps: Keys) -> _Reference:
        return _Reference([value for _, value in _entries(tree, steps)])

    yield from value_breaches((), tree)
    yield from _parameter_breaches(tree["machine"]["parameters"])
    for line in filter(None, RULES.splitlines()):
        pattern, relation, other = line.split()
        for field in _expanded(pattern):
            for keys, value in _entries(tree, field.rstrip("?").split("/")):
                if value or not field.endswith("?"):
                    yield from _rule_breaches(reference, (keys, value), relation, other)


def _expanded(pattern: str) -> list[str]:
    """A pattern with each of the names in braces."""
    head, brace, rest = pattern.partition("{")
    if not brace:
        return [pattern]
    names, _, tail = rest.partition("}")
    return [
        f"{head}{name}{end}" for name in names.split(",") for end in _expanded(tail)
    ]


def _entries(tree: Any, steps: Sequence[str], keys: Keys = ()) -> Iterator[Entry]:
    """Keys and values of what a pattern stands for; nothing of what is null or absent."""
    if tree is None:
        return
    if not steps:
        yield keys, tree
        return
    for key, value in _children(tree, steps[0]):
        yield from _entries(value, steps[1:], (*keys, key))


def _children(tree: Any, step: str) -> Iterator[tuple[str, Any]]:
    """Keys and values of a table or list that a step of a pattern stands for."""
    if isinstance(tree, list | tuple):
        every = step in EVERY
        numbers = range(len(tree)) if every else [int(step)]
        yield from ((str(k), tree[k]) for k in numbers if k < len(tree))
    elif step in EVERY:
        yield from tree.items()
    else:
        yield step, tree.get(step)


def _rule_breaches(
    reference: Callable[[Keys], _Reference], entry: Entry, relation: str, other: str
) -> Iterator[Breach]:
    """Where a field does not agree with the other one of a rule."""
    keys, value = entry
    ups = other.count("..")
    steps = (*(keys[:-ups] if ups else ()), *other.rstrip("?").split("/")[ups:])
    compared = reference(steps)
    others = compared.values
    if not others or (other.endswith("?") and not any(others)):
        return
    if relation in ("length", "at_most", "one_more"):
        size = _count(value)
        expected = _count(others[0]) + (relation == "one_more")
        if size > expected or (size < expected and relation != "at_most"):
            words = f"{size}, where {_field(steps)} has {expected}"
            yield Breach(_field(keys), words)
        return
    names = _names([value])
    allowed = compared.names
    for name in names:
        if name not in allowed:
            of = _field(steps)
            remedy = suggest(name, allowed, kind=of, limit=12)
            words = f"{shorten(name, 40)!r} is not in {of}; {remedy}"
            yield Breach(_field(keys), words)
    for name in allowed if relation == "names" else ():
        if name not in names:
            words = f"{shorten(name, 40)!r} is missing, which {_field(steps)} has"
            yield Breach(_field(keys), words)


def _count(value: Any) -> int:
    return value if isinstance(value, int) else len(value)


def _names(values: list[Any]) -> Collection[str]:
    """The names in tables, lists or texts, each once."""
    parts = [[value] if isinstance(value, str) else value for value in values]
    return dict.fromkeys(str(name) for part in parts for name in part)


def _field(keys: Keys) -> str:
    """A field as in a message: entries of lists by their number, from 1."""
    dotted = ".".join(keys).replace(".#", "")
    return re.sub(r"\.(\d+)\b", lambda number: f"[{int(number[1]) + 1}]", dotted)


def value_breaches(keys: Keys, value: Any) -> Iterator[Breach]:
    """Numbers and units anywhere within a value that no result has."""
    if isinstance(value, Mapping | list | tuple):
        pairs = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, entry in pairs:
            below = (*keys, str(key))
            if key in UNIT_FIELDS and isinstance(entry, str | Mapping):
                yield from _unit_breaches(below, entry)
            yield from value_breaches(below, entry)
    elif isinstance(value, int | float) and not abs(value) < MAX_NUMBER:
        yield Breach(_field(keys), f"{value:.3g} is no number of a result")


def _unit_breaches(keys: Keys, value: Any) -> Iterator[Breach]:
    """Units that nobody knows: no products of known ones, with their powers."""
    if isinstance(value, Mapping):
        for name, entry in value.items():
            yield from _unit_breaches((*keys, str(name)), entry)
        return
    of_effects = [shown for shown, _ in units.EFFECT.values()]
    known_units = {*units.UNITS, *OTHER_UNITS, *of_effects}
    factors = str(value).replace("/", " ").split()
    if not all(
        factor in known_units or factor.rstrip("23") in known_units
        for factor in factors
    ):
        yield Breach(_field(keys), f"{shorten(str(value), 40)!r} is no known unit")


def _parameter_breaches(rows: list[dict[str, Any]]) -> Iterator[Breach]:
    """Parameters without name, unit or numbers: a later stage looks them up."""
    kinds: dict[str, Any] = {
        "name": str,
        "unit": str,
        "nominal": (int, float),
        "tolerance": (int, float),
    }
    for k, row in enumerate(rows, start=1):
        for key, kind in kinds.items():
            if not isinstance(row.get(key), kind):
                field = f"machine.parameters[{k}].{key}"
                yield Breach(field, f"{row.get(key)!r} is no {key}")
