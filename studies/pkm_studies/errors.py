"""Bad input, told in one paragraph: which file, which field, which value, what to do
about it.

Fields are dotted paths as in the file; entries of lists count from 1
(`setup[2].length_mm`).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable
from typing import Final

#: longest value, problem and remedy that are told
VALUE, PROBLEM, REMEDY = 60, 220, 240
_MISSING: Final = object()


class InputError(Exception):
    """An input that cannot be used. `str()` is one paragraph without line breaks."""

    def __init__(
        self,
        problem: str,
        remedy: str,
        *,
        file: str = "",
        field: str = "",
        value: str = "",
    ) -> None:
        self.problem, self.remedy = shorten(problem, PROBLEM), shorten(remedy, REMEDY)
        self.file, self.field, self.value = (
            file,
            shorten(field, 2 * VALUE),
            shorten(value, VALUE),
        )
        super().__init__(self._told())

    def _told(self) -> str:
        subject = (
            f"{self.field} = {self.value}"
            if self.value and self.field
            else self.field or self.value
        )
        return (
            ": ".join(part for part in (self.file, subject, self.problem) if part)
            + f"; {self.remedy}."
        )


class SourceAbsentError(InputError):
    """Data that a study reads from outside the project is not there."""


@dataclasses.dataclass(frozen=True, slots=True)
class Place:
    """Where in which file a value stands."""

    file: str
    field: str = ""

    def key(self, name: str) -> Place:
        """A field of the table at this place."""
        return Place(self.file, f"{self.field}.{name}" if self.field else name)

    def item(self, index: int) -> Place:
        """An entry, by its index from 0, of the list at this place."""
        return Place(self.file, f"{self.field}[{index + 1}]")

    def error(self, problem: str, remedy: str, value: object = _MISSING) -> InputError:
        """The error to raise for a value at this place."""
        told = "" if value is _MISSING else quote(value)
        return InputError(problem, remedy, file=self.file, field=self.field, value=told)


def quote(value: object) -> str:
    """A value of a study as a person wrote it, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    if isinstance(value, str):
        return f'"{value}"'
    return shorten(str(value), VALUE)


def shorten(text: str, length: int) -> str:
    """Text on one line, printable, of at most `length` characters."""
    line = " ".join(
        "".join(c if c.isprintable() else " " for c in text[: 4 * length]).split()
    )
    return line if len(line) <= length else line[: length - 4].rstrip() + " ..."


def suggest(word: str, known: Iterable[str], kind: str = "allowed") -> str:
    """Remedy for an unknown name: the nearest known one, and the list."""
    names = list(dict.fromkeys(known))
    if not names:
        return f"nothing is {kind} here: remove it"
    near = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    listed = f"{kind}: {', '.join(names)}"
    return f"did you mean {near[0]}? ({listed})" if near else listed
