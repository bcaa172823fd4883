"""A study from a form: the text that `oed new` drafts, with a machine's sizes and aims."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from oed import units
from oed.instrument import Instrument
from oed.mechanism import Kinematics
from oed.model import Dimension, Machine
from pkm_page import typed
from pkm_reports.view import PageView, ViewLine
from pkm_studies import catalogue, files, shipped
from pkm_studies.base import InputError, Location
from pkm_studies.drafts import (
    SHARES,
    default_instrument,
    draft_text,
    first_sound,
    format_numbers,
)
from pkm_studies.quantities import column
from pkm_studies.resolve import described_machine
from pkm_studies.study import SUFFIX
from pkm_studies.tables import MachineTable
from pkm_studies.user_code import Consent, Origin

#: characters of a size, as a list of numbers
LONGEST: Final = 2000
#: fewest and most readings that a time is turned into
FEWEST, MOST = 6, 300
#: beginnings of the names of fields
GEOMETRY, WANTED = "geometry.", "wanted."


class NewStudy(msgspec.Struct, forbid_unknown_fields=True):
    """What the form holds: names, sizes by key as TOML, minutes, wanted rms by key."""

    machine: str
    name: str = ""
    instrument: str = ""
    sizes: dict[str, str] = {}
    minutes: str = ""
    wanted: dict[str, str] = {}


@dataclasses.dataclass(frozen=True)
class SizeField:
    """A size to enter: its key, its value as TOML, and what it is."""

    key: str
    value: str
    about: str


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
        first, others = default_instrument(self._model(machine), self.origin)
        return [first, *others]

    def sizes(self, machine: str) -> list[SizeField]:
        """The sizes of a family; none of a machine of one size."""
        family = self._model(machine).family
        if family is None:
            return []
        return [
            SizeField(
                _key(d),
                "" if d.default is None else format_numbers(d.default, d.unit),
                d.about,
            )
            for d in family.dimensions
        ]

    def components(self, machine: str) -> list[str]:
        """Errors that may be limited: keys such as `z_um`."""
        return [
            f"{c.name}_{units.FINE[c.unit]}" for c in self._model(machine).components
        ]

    def drawing(self, form: NewStudy) -> PageView:
        """The machine at home. Raises FieldError for sizes that make none."""
        machine = self._machine(form)
        kinematics = Kinematics(machine)
        x, q = kinematics.inverse(machine.home_command)
        skeleton = kinematics.skeleton(x[0], q[0], machine.nominal)
        lines = [
            ViewLine("machine", [[1e3 * float(v) for v in point] for point in line])
            for line in skeleton
        ]
        return PageView(lines, [], [], [], [])

    def write(self, form: NewStudy) -> Path:
        """Write the study of a form; its path. Raises FieldError, InputError."""
        machine = self._machine(form)
        try:
            path = shipped.new_path(form.name or machine.name, self.folder)
        except InputError as error:
            raise FieldError("name", error) from error
        if form.instrument not in self.instruments(form.machine):
            raise _error("instrument", "it cannot read this machine", "choose another")
        tool = catalogue.instrument(
            form.instrument, self.origin, Location("form")
        ).for_machine(machine)
        if tool.single:
            tool = tool.take_channels([tool.channels[0].name])
        study = path.name.removesuffix(SUFFIX)
        texts = (self._draft(form, study, machine, tool, share) for share in SHARES)
        text = first_sound(texts, path, self.origin)
        return files.write_whole(path, text)

    def _draft(
        self,
        form: NewStudy,
        name: str,
        machine: Machine,
        tool: Instrument,
        share: float,
    ) -> str:
        text = draft_text(name, form.machine, machine, form.instrument, tool, share)
        text = _add_sizes(text, self._stated(form))
        text = _add_readings(text, form.minutes, tool)
        return _add_wanted(text, form.wanted, self.components(form.machine))

    def _stated(self, form: NewStudy) -> dict[str, str]:
        """Sizes that differ from the family's, as TOML by key. Raises FieldError."""
        fields = {field.key: field for field in self.sizes(form.machine)}
        stated = {}
        for key, value in form.sizes.items():
            if key not in fields:
                raise _error(GEOMETRY + key, "no such size", "load the page again")
            if value.strip() and value.strip() != fields[key].value:
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


def _key(dimension: Dimension) -> str:
    if dimension.unit == "1":
        return dimension.name
    return column(dimension.name, dimension.unit)


def _error(name: str, problem: str, remedy: str, value: str = "") -> FieldError:
    return FieldError(name, InputError(problem, remedy, field=name, value=value))


def _field_of(error: InputError, sizes: list[str]) -> str:
    """The field of the form that an error in [machine] is about."""
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
        if len(value) > LONGEST or "\n" in value:
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


def _add_readings(text: str, minutes: str, tool: Instrument) -> str:
    """The draft with as many readings as a time has, mounting and reading counted."""
    if not minutes.strip():
        return text
    try:
        seconds = typed.read(minutes, "minutes") * units.MINUTE
    except InputError as error:
        raise FieldError("minutes", error) from error
    count = int((seconds - tool.cost.setup) / max(tool.cost.reading, 1.0))
    if count < FEWEST:
        least = (tool.cost.setup + FEWEST * tool.cost.reading) / units.MINUTE
        problem = f"too short: mounting and {FEWEST} readings take {least:.0f} min"
        raise _error("minutes", problem, "allow more time", minutes)
    limit = re.search(r"^readings = (\d+)$", text, re.M)
    most = MOST if limit is None else 2 * int(limit[1])
    return re.sub(
        r"^readings = \d+$", f"readings = {min(count, most)}", text, flags=re.M
    )


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
