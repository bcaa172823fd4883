"""Names of studies and campaigns: they become names of files, and so are no paths."""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Annotated, Final

import msgspec

from oed.text import shorten

# Errors about bad input: one paragraph with file, field, value and remedy.
#
# Fields are dotted paths as in the file; entries of lists count from 1
# (`setup[2].length_mm`).

VALUE = 60  #: characters of a value, at most
PROBLEM = 220  #: of a problem
REMEDY = 240  #: of a remedy
_MISSING: Final = object()


class InputError(Exception):
    """An input that cannot be used. `str()` is one paragraph without line breaks.

    >>> import oed
    >>> try:
    ...     oed.build_study({"name": "gauge", "machine": {"modell": "planar_2dof"}})
    ... except oed.InputError as error:
    ...     print(error)
    gauge.study.toml: machine.modell: unknown field; did you mean model? (...)...
    """

    def __init__(
        self,
        problem: str,
        remedy: str,
        *,
        file: str = "",
        field: str = "",
        value: str = "",
    ) -> None:
        """Shorten all parts to what fits in one paragraph."""
        self.file = file
        self.field = shorten(field, 2 * VALUE)
        self.value = shorten(value, VALUE)
        self.problem = shorten(problem, PROBLEM)
        self.remedy = shorten(remedy, REMEDY)
        super().__init__(self._paragraph())

    def _paragraph(self) -> str:
        subject = self.field or self.value
        if self.field and self.value:
            subject = f"{self.field} = {self.value}"
        parts = [part for part in (self.file, subject, self.problem) if part]
        end = "" if self.remedy.endswith("...") else "."
        return f"{': '.join(parts)}; {self.remedy}{end}"


class SourceAbsentError(InputError):
    """Data that a study reads from outside the project is not there."""


@dataclasses.dataclass(frozen=True, slots=True)
class Location:
    """File and field of a value."""

    file: str
    field: str = ""

    def key(self, name: str) -> Location:
        """A field of the table at this place."""
        return Location(self.file, f"{self.field}.{name}" if self.field else name)

    def item(self, index: int) -> Location:
        """An entry, by its index from 0, of the list at this place."""
        return Location(self.file, f"{self.field}[{index + 1}]")

    def path(self, *steps: str | int) -> Location:
        """A place below this one, by keys of tables and indices, from 0, of lists."""
        place = self
        for step in steps:
            place = place.key(step) if isinstance(step, str) else place.item(step)
        return place

    def error(self, problem: str, remedy: str, value: object = _MISSING) -> InputError:
        """The error to raise for a value at this place."""
        text = "" if value is _MISSING else quote(value)
        return InputError(problem, remedy, file=self.file, field=self.field, value=text)


def quote(value: object) -> str:
    """A value of a study as it is written in the file, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    if isinstance(value, str):
        return f'"{value}"'
    return shorten(str(value), VALUE)


#: nothing follows the end: Python lets a line feed, which is no letter a, follow `$`
NAME_PATTERN: Final = "^[A-Za-z0-9][A-Za-z0-9_-]*$(?![^a])"
Name = Annotated[str, msgspec.Meta(pattern=NAME_PATTERN)]


def check_name(name: str, location: Location) -> None:
    """Raises InputError for a text at a place that is no name."""
    if not re.search(NAME_PATTERN, name):
        problem, remedy = "this is no name for a study", "use letters, digits, _ and -"
        raise location.error(problem, remedy, name)
