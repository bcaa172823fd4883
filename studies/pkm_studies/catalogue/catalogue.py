"""What there is to choose from, and how a name in a study becomes an object.

A model is named by its short name (`a3_head`), by `package.module:attribute`, or by
`path/to/file.py:attribute` in the study's folder; in the last two the attribute may be
left out where it is `machine`, `instrument` or `effect`. An installed package adds its
own under the entry points `pkm_oed.machines`, `pkm_oed.instruments`, `pkm_oed.effects`,
`pkm_oed.formats`; only modules of these entry points and of this project have a long
name. A file runs once the user allowed it: see `user_code`. A controller's format is
found likewise; its attribute is `controller`.
"""

import dataclasses
import functools
import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from oed.text import shorten, suggest
from pkm_studies import user_code
from pkm_studies.base import Location
from pkm_studies.plugins import GROUPS, plugins, project_plugins
from pkm_studies.user_code import Origin

MAX_REASON_LENGTH = 120  #: characters of an error that are shown

KINDS = ("machines", "instruments", "effects", "criteria", "formats")
#: packages with the shipped ones of a kind, and attribute that may be left out, where
#: these are not `pkm_models.KIND` and the kind's singular
PACKAGES = {"formats": "pkm_studies.compensation.formats"}
ATTRIBUTES = {"formats": "controller"}
#: module and name of the class of a kind's items
CLASSES = {
    "machines": ("oed.model", "Machine"),
    "instruments": ("oed.instrument", "Instrument"),
    "effects": ("oed.effect_model", "Effect"),
    "formats": ("pkm_studies.catalogue.controller_format", "ControllerFormat"),
}
#: where a study or a command names what the file of a user holds
USES = {
    "machine": "into model of [machine], or to `oed check`",
    "instrument": "into instrument of a [[setup]]",
    "effect": "into effects of [gap] in a study; `oed check` the study",
    "controller": "to `oed compensate DIR --to FILE`",
    "importer": "to `oed import FILE`",
}
#: how a file gives an item that is no plain instance of its class
OBJECTS = {"importers": "give an object, not a class, with name, about, read(request)"}


@dataclasses.dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One entry of the catalogue.

    where    the long name that a study may use as well
    frames   of a machine: base frame, tool axis, orientation, in sentences
    columns  of a machine or an instrument: name with unit, role and meaning
    """

    name: str
    about: str
    source: str
    where: str
    frames: list[str] = dataclasses.field(default_factory=list)
    columns: list[dict[str, str]] = dataclasses.field(default_factory=list)


def listing(kind: str) -> list[CatalogueEntry]:
    """The catalogue of one of KINDS, by name."""
    if kind == "criteria":  # the kernel's own: no package adds to them
        from oed.design import CRITERIA

        return [
            CatalogueEntry(c.name, c.about, c.source, f"oed.design.criteria:{c.name}")
            for c in CRITERIA.entries.values()
        ]
    return [
        CatalogueEntry(name, item.about, item.source, where)
        for name, (where, item) in sorted(named_items(kind).items())
    ]


def machine(
    reference: str, origin: Origin, location: Location, *, assembled: bool = True
) -> Any:
    """The `oed.model.Machine` of a name, one's own `assembled`. Raises InputError."""
    from oed.model import Machine
    from pkm_studies.catalogue import machine_check as soundness

    machine = lookup(reference, "machines", Machine, origin, location)
    if ":" in reference or user_code.is_file(reference):
        soundness.check_machine(machine, location, assembled=assembled)
    return machine


def instrument(reference: str, origin: Origin, location: Location) -> Any:
    """The `oed.instrument.Instrument` that `reference` names. Raises InputError."""
    from oed.instrument import Instrument

    return lookup(reference, "instruments", Instrument, origin, location)


def effect(reference: str, origin: Origin, location: Location) -> Any:
    """The `oed.effect_model.Effect` that `reference` names. Raises InputError."""
    from oed.effect_model import Effect

    item = lookup(reference, "effects", Effect, origin, location)
    if not user_code.is_file(reference):
        return item
    columns = functools.partial(_sound_columns, item, reference, location)
    return dataclasses.replace(item, columns=columns)


def _sound_columns(
    effect: Any, reference: str, location: Location, state: Any, **constants: float
) -> Iterator[Any]:
    """The columns of a user's effect. Raises InputError where one fits no state."""
    for column in effect.columns(state, **constants):
        misfit = column.misfit(state)
        if misfit:
            remedy = "mend the function `columns` of the file"
            problem = f"column {column.name!r}: {misfit}"
            raise location.error(problem, remedy, reference)
        yield column


def function(reference: str, origin: Origin, location: Location) -> Callable[..., Any]:
    """The function that a path or a module names. Raises InputError."""
    module_name, _, name = reference.rpartition(":")
    if not module_name or name.endswith(".py"):
        remedy = "write path/to/file.py:function"
        raise location.error("this names no function", remedy, reference)
    module = _module(module_name, origin, location)
    item: Callable[..., Any] | None = getattr(module, name, None)
    if callable(item):
        return item
    there = [n for n, v in vars(module).items() if inspect.isfunction(v)]
    raise location.error(
        f"there is no function {name} in it", _remedy(name, there), reference
    )


def _remedy(name: str, there: list[str]) -> str:
    """Remedy for a file of a user that lacks a name, where others of its kind are there."""
    return suggest(name, there, "there is") if there else f"define {name} in it"


@functools.cache
def named_items(kind: str) -> dict[str, tuple[str, Any]]:
    """Machines, instruments, effects or formats by name, each with its long name."""
    wanted = _item_class(kind)
    package = importlib.import_module(PACKAGES.get(kind, f"pkm_models.{kind}"))
    items: dict[str, tuple[str, Any]] = {}
    for info in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        for attribute, item in vars(importlib.import_module(info.name)).items():
            if isinstance(item, wanted):
                items.setdefault(item.name, (f"{info.name}:{attribute}", item))
    for point, item in _installed(kind):
        if isinstance(item, wanted):
            items.setdefault(item.name, (point.value, item))
    return items


def _item_class(kind: str) -> Any:
    module_name, class_name = CLASSES[kind]
    return getattr(importlib.import_module(module_name), class_name)


def _installed(kind: str) -> Iterator[tuple[EntryPoint, Any]]:
    """Objects that installed packages offer under the entry points `pkm_oed.KIND`.

    One that cannot be loaded is named in a warning and passed over: a broken package
    must not take the catalogue along.
    """
    for point in plugins(kind):
        try:
            item = point.load()
        except Exception as error:  # a user's module may raise anything
            text = shorten(str(error), MAX_REASON_LENGTH)
            warnings.warn(
                f"{point.group} of an installed package: {point.value} cannot be"
                f" loaded: {type(error).__name__}: {text}",
                stacklevel=2,
            )
            continue
        yield point, item


def lookup(
    reference: str, kind: str, wanted: type, origin: Origin, location: Location
) -> Any:
    """The item of class `wanted` that `reference` names. Raises InputError."""
    module_name = user_code.file_name(reference)
    if not module_name:
        return _named_shortly(reference, kind, location)
    module = _module(module_name, origin, location)
    usual = ATTRIBUTES.get(kind, kind.removesuffix("s"))
    attribute = reference[len(module_name) + 1 :] or usual
    item = getattr(module, attribute, None)
    if isinstance(item, wanted) and not inspect.isclass(item):
        return item
    if item is not None:
        problem = f"{attribute} is no {wanted.__name__}"
        remedy = OBJECTS.get(kind, f"write {attribute} = {wanted.__name__}(...)")
        raise location.error(problem, remedy, reference)
    there = [n for n, v in vars(module).items() if isinstance(v, wanted)]
    remedy = _remedy(attribute, there)
    others = [name for name in USES if hasattr(module, name)]
    if others and not there:
        remedy = f"its {others[0]} goes {USES[others[0]]}"
    raise location.error(f"there is no {attribute} in it", remedy, reference)


def _named_shortly(name: str, kind: str, location: Location) -> Any:
    item = _shipped_item(name, kind)
    if item is not None:
        return item
    items = named_items(kind)
    if name not in items:
        remedy = (
            suggest(name, sorted(items), "known")
            + ", or a file of your own: path/to/file.py:attribute"
        )
        raise location.error(f"no such {kind.removesuffix('s')}", remedy, name)
    return items[name][1]


def _shipped_item(name: str, kind: str) -> Any | None:
    """The project's item in the module of its name, or at its entry point; else None.

    Importing one module takes less than reading the catalogue, which prefers the
    project's items to those of other packages.
    """
    package = PACKAGES.get(kind, f"pkm_models.{kind}")
    if not name.isidentifier():
        return None
    if find_spec(f"{package}.{name}") is None:
        added = project_plugins(kind).get(name)
        return None if added is None else added.load()
    items = vars(importlib.import_module(f"{package}.{name}")).values()
    item_class = _item_class(kind)
    named = (item for item in items if isinstance(item, item_class))
    return next((item for item in named if item.name == name), None)


def _module(name: str, origin: Origin, location: Location) -> ModuleType:
    """A file's module, or one of an entry point; none else is imported."""
    if name.endswith(user_code.SUFFIX):
        return user_code.run_file(name, origin, location)
    if name not in _named_modules():
        raise location.error(
            "this module belongs to no installed machine, instrument, effect or format",
            "name a file in the study's folder, path/to/file.py:attribute, or a module"
            " of an entry point pkm_oed.* of an installed package",
            name,
        )
    try:
        return importlib.import_module(name)
    except Exception as error:  # a package's module may raise anything
        raise location.error(
            f"importing it failed with {type(error).__name__}:"
            f" {shorten(str(error), MAX_REASON_LENGTH)}",
            "mend or uninstall the package that provides it",
            name,
        ) from error


def _named_modules() -> set[str]:
    """Modules that a long name may begin with, without importing them."""
    points = entry_points()
    groups = [group for group in points.groups if group.startswith(GROUPS)]
    names = {point.module for group in groups for point in points.select(group=group)}
    for kind in ("machines", "instruments", "effects", "formats"):
        package = importlib.import_module(PACKAGES.get(kind, f"pkm_models.{kind}"))
        listed = pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
        names |= {info.name for info in listed}
    return names
