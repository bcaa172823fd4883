"""What the whole package rests on: refusals of bad input, names, progress, random streams.

InputError         bad input: what, where (file, field, value), and the remedy
Location           a file and a field in it, which make such an error
SourceAbsentError  published readings that are not on this computer
Name               the name of a study or campaign, as a type of its files
NAME_PATTERN       what such a name is
check_name         refuses what is none
Progress           what long work reports to
Silent             progress that nobody watches
Stream             the stream of random numbers of each purpose
"""

from __future__ import annotations

import dataclasses
import enum
import math
import re
from typing import Annotated, Final, Protocol

import msgspec
import numpy as np

from oed.text import shorten

# Names of studies and campaigns: they become names of files, and so are no paths.


# Errors about bad input: one paragraph with file, field, value and remedy.
#
# Fields are dotted paths as in the file; entries of lists count from 1
# (`setup[2].length_mm`).

#: most characters of a value, a problem and a remedy
VALUE, PROBLEM, REMEDY = 60, 220, 240
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


# How long work reports its progress.


class Progress(Protocol):
    """What a pipeline reports: the stage that begins, and the share that is done."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def share(self, done: float) -> None:
        """The share (0..1) of the present stage that is done."""


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str) -> None:
        """Ignore the stage."""

    def share(self, done: float) -> None:
        """Ignore the share."""


# Random numbers of a study: one stream for each purpose, all from the study's seed.


@enum.unique
class Stream(enum.IntEnum):
    """Independent random streams: more draws in one leave the others as they are.

    A seed alone gives the numbers of stream 0, for NumPy takes (seed,) and (seed, 0) as
    one: so whatever draws has a stream of its own.
    """

    DESIGN = 0
    TRUTH = 1
    NOISE = 2
    SAMPLER = 3
    PREDICT = 4
    MACHINES = 5
    HELD_OUT = 6
    PLAN = 7
    CAMPAIGN = 8
    EFFECTS = 9
    GAP = 10
    BEFORE = 11
    CHECKS = 12
    CORRECTED = 13
    ACCEPTANCE = 14
    HISTORY = 15
    PREDICTIVE = 16
    UNMODELLED = 17
    TOOLS = 19
    LAPLACE = 20
    FORECAST = 22
    MIXTURE = 23
    VISIT = 24
    MIXTURE_ACCURACY = 25
    PLANNED_COURSES = 26
    HOW_MANY = 27

    def key(self, seed: int) -> list[int]:
        """What determines the random numbers of this stream."""
        return [seed, int(self)]

    def rng(self, seed: int) -> np.random.Generator:
        """Random numbers of this stream."""
        return np.random.default_rng(self.key(seed))
