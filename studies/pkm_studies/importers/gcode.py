"""Commands and replies in a printer's log or configuration: M665 R100 L250."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from pkm_studies import files
from pkm_studies.errors import InputError
from pkm_studies.importers.base import line_field

LIMIT = 16_000_000
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
COMMAND = re.compile(r"\b([GM]\d+)\b((?:\s+[A-Z][^\s;]*)*)")
WORD = re.compile(rf"([A-Z])({NUMBER}(?::{NUMBER})*)?")


@dataclasses.dataclass(frozen=True, slots=True)
class TextLine:
    """A line of a file."""

    text: str
    file: str
    number: int

    def error(self, problem: str, remedy: str, what: str = "") -> InputError:
        """The error to raise for this line."""
        field = line_field(self.number, what)
        return InputError(
            problem, remedy, file=self.file, field=field, value=self.text.strip()
        )


@dataclasses.dataclass(frozen=True, slots=True)
class Command:
    """A command with its words as written: `M665 L250:250:250` has L = "250:250:250"."""

    name: str
    words: dict[str, str]
    line: TextLine

    def number(self, letter: str, default: float | None = None) -> float:
        """The number of a word. Raises InputError where it is missing."""
        text = self.words.get(letter)
        if text is None and default is not None:
            return default
        if not text:
            problem = f"{self.name} has no {letter}"
            raise self.line.error(
                problem, "give the full command, as the printer has it"
            )
        return finite(text.split(":")[0], self.line)


def read(paths: Sequence[Path]) -> list[TextLine]:
    """Lines of the files, comments after ; cut off. Raises InputError."""
    lines = []
    for path in paths:
        text = files.read_text(path, limit=LIMIT, what="log or configuration")
        for number, line in enumerate(text.splitlines(), start=1):
            lines.append(TextLine(line.partition(";")[0], str(path), number))
    return lines


def commands(lines: Iterable[TextLine], *names: str) -> Iterator[Command]:
    """Commands of these names, in order."""
    for line in lines:
        for match in COMMAND.finditer(line.text):
            if match[1] in names:
                words = {word[1]: word[2] or "" for word in WORD.finditer(match[2])}
                yield Command(match[1], words, line)


def merged(lines: Sequence[TextLine], name: str, remedy: str) -> Command:
    """A setting command with the last value of every word. Raises InputError."""
    words: dict[str, str] = {}
    last: Command | None = None
    for command in commands(lines, name):
        words |= command.words
        last = command
    if last is None:
        files_read = ", ".join(dict.fromkeys(line.file for line in lines))
        raise InputError(f"no {name} in it", remedy, file=files_read)
    return Command(name, words, last.line)


def finite(text: str, line: TextLine) -> float:
    """A number of a reply. Raises InputError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise line.error("not a finite number", "correct or remove the line", text)
    return value
