"""A study from a form: the text that `oed new` drafts, with a machine's sizes and aims."""

import dataclasses
import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from oed import units
from oed.mechanism import Kinematics
from oed.model import Dimension, Machine
from pkm_page import typed
from pkm_reports.text import unit_symbol
from pkm_reports.view import PageView
from pkm_studies import catalogue, describe, shipped
from pkm_studies.base import InputError, Location
from pkm_studies.drafts import StartingModel, format_numbers, read_time, write_draft
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import described_machine
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent, Origin

MAX_SIZE_CHARACTERS: Final = 2000  #: characters of a size, as a list of numbers
SIZE_DIGITS: Final = 7  #: digits of a size in its cell
AXES: Final = ("x", "y", "z")  #: names of three coordinates, as heads of a table
#: sizes that are one point, where others of three numbers are one for each leg
POINTS: Final = ("home", "pivot")
GEOMETRY, WANTED = "geometry.", "wanted."  #: beginnings of the names of fields


class NewStudy(msgspec.Struct, forbid_unknown_fields=True):
    """What the form holds: names, sizes by key as TOML, a time, wanted rms by key."""

    machine: str
    name: str = ""
    instrument: str = ""
    sizes: dict[str, str] = {}
    time: str = ""
    wanted: dict[str, str] = {}


@dataclasses.dataclass(frozen=True)
class SizeField:
    """A size to enter, as a table of numbers."""

    key: str  #: in the study
    label: str  #: its name with its unit, as one reads it
    rows: list[list[str]]  #: of texts; empty ones where the family derives the value
    heads: list[str]  #: of the columns; none of one number
    about: str
    nested: bool  #: the value is a list of rows
    places: bool  #: the rows are points, as those of a circle on a drawing
    growing: bool  #: there may be more rows, or fewer

    @property
    def derived(self) -> bool:
        """Whether it may stay empty."""
        return not self.rows[0][0]


class FieldError(InputError):
    """An error of one field of the form."""

    def __init__(self, name: str, error: InputError) -> None:
        super().__init__(
            error.problem, error.remedy, field=error.field, value=error.value
        )
        self.name = name


class StudyForm:
    """Studies that are written into one folder, without code of a user's."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.origin = Origin(folder, Consent.NEVER)

    def machines(self) -> list[str]:
        """Machines and families by name."""
        return [entry.name for entry in catalogue.listing("machines")]

    def instruments(self, machine: str) -> list[str]:
        """Instruments that can read a machine as it stands, the usual one first."""
        start = StartingModel(machine, self._model(machine))
        first, others = start.default_instrument(self.origin)
        return [first, *others]

    def sizes(self, machine: str) -> list[SizeField]:
        """The sizes of a family; none of a machine of one size."""
        family = self._model(machine).family
        if family is None:
            return []
        lists = [d.default for d in family.dimensions if None in d.shape]
        count = max((len(np.atleast_1d(v)) for v in lists), default=1)
        return [_size_field(d, count) for d in family.dimensions]

    def components(self, machine: str) -> dict[str, str]:
        """Errors that may be limited, `z [\u00b5m]`, by key such as `z_um`."""
        fine = {c.name: units.FINE[c.unit] for c in self._model(machine).components}
        return {f"{name}_{u}": f"{name} [{unit_symbol(u)}]" for name, u in fine.items()}

    def drawing(self, form: NewStudy) -> PageView:
        """The machine at home. Raises FieldError for sizes that make none."""
        machine = self._machine(form)
        kinematics = Kinematics(machine)
        x, q = kinematics.inverse(machine.home_command)
        skeleton = kinematics.skeleton(x[0], q[0], machine.nominal)
        labels = describe.parameter_labels(kinematics, x[0], q[0])
        return PageView.from_machine(skeleton, [(one.at, one.text) for one in labels])

    def write(self, form: NewStudy) -> Path:
        """Write the study of a form; its path. Raises FieldError, InputError."""
        machine = self._machine(form)
        try:
            path = shipped.new_path(form.name or machine.name, self.folder)
        except InputError as error:
            raise FieldError("name", error) from error
        if form.instrument not in self.instruments(form.machine):
            raise _error("instrument", "it cannot read this machine", "choose another")
        stated, allowed = self._stated(form), list(self.components(form.machine))

        def complete(draft: str) -> str:
            return _add_wanted(_add_sizes(draft, stated), form.wanted, allowed)

        start = StartingModel(form.machine, machine)
        tool, origin = form.instrument, self.origin
        try:
            seconds = read_time(form.time) if form.time.strip() else None
            return write_draft(path.name, start, tool, origin, seconds, complete)
        except InputError as error:
            if error.field == "time":
                raise FieldError("time", error) from error
            raise

    def _stated(self, form: NewStudy) -> dict[str, str]:
        """Sizes that differ from the family's, as TOML by key. Raises FieldError."""
        family = self._model(form.machine).family
        dimensions = () if family is None else family.dimensions
        usual = {_key(d): _default_text(d) for d in dimensions}
        stated = {}
        for key, value in form.sizes.items():
            if key not in usual:
                raise _error(GEOMETRY + key, "no such size", "load the page again")
            if value.strip() and not _same(key, value, usual[key]):
                stated[key] = value.strip()
        return stated

    def _machine(self, form: NewStudy) -> Machine:
        """The machine of the form's sizes. Raises FieldError."""
        geometry = {
            key: _parsed(key, value) for key, value in self._stated(form).items()
        }
        self._model(form.machine)
        table = MachineTable(model=form.machine, geometry=geometry)
        try:
            return described_machine(table, self.origin, Location("form", "machine"))
        except InputError as error:
            keys = [field.key for field in self.sizes(form.machine)]
            raise FieldError(_field_of(error, keys), error) from error

    def _model(self, name: str) -> Machine:
        if name not in self.machines():
            raise _error("machine", "no such machine", "choose one of the list")
        model: Machine = catalogue.machine(name, self.origin, Location("form"))
        return model


def _size_field(dimension: Dimension, count: int) -> SizeField:
    """The table of a size, of `count` numbers where the length is free."""
    unit = "" if dimension.unit == "1" else display_unit(dimension.unit)
    symbol = f" [{unit_symbol(unit)}]" if unit else ""
    cells = _cells(dimension, count)
    nested = cells.ndim > 1
    rows = np.atleast_2d(cells)
    width = rows.shape[1]
    coordinates = nested or dimension.name in POINTS
    heads = AXES[:width] if coordinates else range(1, width + 1)
    return SizeField(
        key=_key(dimension),
        label=dimension.name + symbol,
        rows=rows.tolist(),
        heads=[str(head) for head in heads] if width > 1 else [],
        about=dimension.about,
        nested=nested,
        places=nested and dimension.unit == "m",
        growing=nested and dimension.shape[0] is None,
    )


def _cells(dimension: Dimension, count: int) -> np.typing.NDArray[np.str_]:
    """The numbers of a size as texts, of its shape; empty where they are derived."""
    shape = tuple(n or count for n in dimension.shape) or (1,)
    default = dimension.default
    if default is None:
        return np.full(shape, "")
    if None in dimension.shape:
        shape = np.shape(default) or shape
    whole = np.broadcast_to(default, shape)
    numbers = json.loads(format_numbers(whole, dimension.unit))
    return np.array([f"{n:.{SIZE_DIGITS}g}" for n in np.ravel(numbers)]).reshape(shape)


def _default_text(dimension: Dimension) -> str:
    """A family's size as TOML; empty where it is derived."""
    if dimension.default is None:
        return ""
    return format_numbers(dimension.default, dimension.unit)


def _same(key: str, value: str, usual: str) -> bool:
    """Whether a size is that of the family, one number for all of a list."""
    if not usual:
        return False
    stated, usual_numbers = np.array(_parsed(key, value)), np.array(_parsed(key, usual))
    try:
        usual_numbers = np.broadcast_to(usual_numbers, stated.shape)
        return bool(
            np.allclose(stated, usual_numbers, rtol=10.0 ** (1 - SIZE_DIGITS), atol=0.0)
        )
    except ValueError:
        return False


def _key(dimension: Dimension) -> str:
    if dimension.unit == "1":
        return dimension.name
    return column(dimension.name, dimension.unit)


def _error(name: str, problem: str, remedy: str, value: str = "") -> FieldError:
    return FieldError(name, InputError(problem, remedy, field=name, value=value))


def _field_of(error: InputError, sizes: list[str]) -> str:
    key = error.field.removeprefix("machine.geometry.").partition("[")[0]
    if key != error.field:
        return GEOMETRY + key
    # a family names the size in its sentence: the first one that it names
    tokens = re.findall(r"\w+", error.problem)
    named = [
        k for word in tokens for k in sizes if k == word or k.rpartition("_")[0] == word
    ]
    return GEOMETRY + named[0] if named else "machine"


def _parsed(key: str, value: str) -> Any:
    """A size as a number or lists of numbers. Raises FieldError."""
    try:
        if len(value) > MAX_SIZE_CHARACTERS or "\n" in value:
            raise ValueError("too long")
        parsed = tomllib.loads(f"value = {value}")["value"]
        numbers = list(_numbers(parsed))
    except (ValueError, RecursionError) as error:
        name = GEOMETRY + key
        remedy = "write a number, or lists of numbers as [[0, 1], [2, 3]]"
        raise _error(name, "these are no numbers", remedy, value) from error
    if not np.isfinite(numbers).all():
        raise _error(GEOMETRY + key, "not finite", "write finite numbers", value)
    return parsed


def _numbers(value: Any) -> Iterator[float]:
    """All numbers of nested lists. Raises ValueError for anything else."""
    if isinstance(value, list):
        for item in value:
            yield from _numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
    else:
        raise ValueError(value)


def _add_sizes(text: str, stated: dict[str, str]) -> str:
    """The draft with sizes in place of the comments that name them."""
    if not stated:
        return text
    text = re.sub(
        r"^# \[machine\.geometry\].*$", "[machine.geometry]", text, flags=re.M
    )
    for key, value in stated.items():
        line = re.compile(rf"^# {re.escape(key)}(?:: | = .*?  # )(.*)$", re.M)
        stating = f"{key} = {value}".replace("\\", r"\\")
        text = line.sub(rf"{stating}  # \1", text)
    return text


def _add_wanted(text: str, wanted: dict[str, str], allowed: list[str]) -> str:
    """The draft with rms errors to reach."""
    stated = []
    for key, value in wanted.items():
        name = WANTED + key
        if key not in allowed:
            raise _error(name, "no such error", "load the page again")
        if not value.strip():
            continue
        try:
            size = typed.read(value, name)
        except InputError as error:
            raise FieldError(name, error) from error
        if size <= 0.0:
            raise _error(name, "not above zero", "write the rms error to reach", value)
        stated.append(f"{key} = {size:g}")
    if not stated:
        return text
    line = f"wanted = {{ {', '.join(stated)} }}  # rms errors to reach"
    if re.search(r"^# wanted = .*$", text, re.M):
        return re.sub(r"^# wanted = .*$", line, text, count=1, flags=re.M)
    return re.sub(r"^(\[prediction\])$", rf"\1\n{line}", text, count=1, flags=re.M)
