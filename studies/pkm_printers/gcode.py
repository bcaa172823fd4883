"""Commands and replies in a printer's log or configuration: M665 R100 L250."""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from oed.base import Array
from pkm_printers.words import WordTable, WrittenWord, account
from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.csv_table import plain_number
from pkm_studies.importers import Stamp, line_field

MAX_BYTES = 16_000_000
NO_TIME = Stamp(0.0, is_dated=False)
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
#: that a number ends there: no decimal comma follows, and no other sign of one
ENDS = r"(?![\w.]|,\d)"
#: what follows a letter: a text in quotes, an expression, or anything up to a blank; a
#: letter with the rest of an English word is none
VALUE = r'(?:"[^"]*"|\{[^{}]*\}|(?![a-z]+(?:\s|$))[^\s"{A-Z]*)'
LETTER = "[A-FH-LN-Z]"  #: letters of words; G and M start the next command of a line
COMMAND = re.compile(
    rf"(?<![\w.])([GM]\d+(?:\.\d+)?)(?![\d.])((?:\s*{LETTER}{VALUE})*)"
)
WORD = re.compile(rf"({LETTER})({VALUE})")
#: commands whose P is the name of a file, which old configurations have without quotes
WITH_FILE = ("M98", "M375")
FILE_WORD = re.compile(r'\s*(P)([^\s"{]+)')

#: numbers of Repetier's EEPROM (M205), and its heights
REPETIER = re.compile(r"EPR:\d \d+ |Z-probe:\s*[-\d]")
OF_REPETIER = (
    "this is a log of Repetier, whose Z-probe lines count from a start that they do not show",
    "write its numbers as a config.g and a log of RepRapFirmware, as the page on imports has"
    " them under Repetier, and take rrf",
)


@dataclasses.dataclass(frozen=True, slots=True)
class TextLine:
    """A line of a file."""

    text: str  #: without the comment after ;
    file: str
    number: int
    raw: str = ""  #: with it

    def error(self, problem: str, remedy: str, what: str = "") -> InputError:
        """The error to raise for this line."""
        field = line_field(self.number, what)
        return InputError(
            problem, remedy, file=self.file, field=field, value=self.text.strip()
        )


@dataclasses.dataclass(frozen=True, slots=True)
class Command:
    """A command with its words as written: `M665 L250:250:250` has L = "250:250:250".

    lines  of words that stand in other lines than `line`
    """

    name: str
    words: dict[str, str]
    line: TextLine
    lines: Mapping[str, TextLine] = dataclasses.field(default_factory=dict)

    def line_of(self, letter: str) -> TextLine:
        """The line that a word is from."""
        return self.lines.get(letter, self.line)

    def number(self, letter: str, default: float | None = None) -> float:
        """The number of a word. Raises InputError where it is missing."""
        if letter not in self.words and default is not None:
            return default
        return self.values(letter)[0]

    def values(self, letter: str, *counts: int) -> list[float]:
        """Numbers of a word, separated by colons, in one of the counts. Raises InputError."""
        line, cells = self.line_of(letter), self.words.get(letter, "").split(":")
        problem = ""
        if not cells[0]:
            problem = f"{self.name} has no {letter}"
        elif counts and len(cells) not in counts:
            wanted = " or ".join(map(str, counts))
            problem = f"{len(cells)} numbers, where {wanted} belong"
        if problem:
            remedy = "give the full command, as the printer has it"
            raise line.error(problem, remedy, f"{self.name} {letter}")
        return [finite(cell, line) for cell in cells]

    def text_of(self, letters: Iterable[str]) -> str:
        """These words as written; those that it lacks are left out."""
        return " ".join(f"{k}{self.words[k]}" for k in letters if k in self.words)

    def numbers(self, letters: str) -> Array:
        """Numbers (n,) of words; 0 of those that it lacks. Raises InputError."""
        return np.array([self.number(letter, 0.0) for letter in letters])


def read(paths: Sequence[Path]) -> list[TextLine]:
    """Lines without comments, in the order of time. Raises InputError for jumps of it."""
    logs = []
    for path in paths:
        text = files.read_text(
            path, limit=MAX_BYTES, what="log or configuration", is_foreign=True
        )
        logs.append(_is_in_time(lines_of(text, str(path))))
    dated = [k for k, log in enumerate(logs) if log.start and log.start.is_dated]
    by_date = sorted((logs[k] for k in dated), key=lambda log: log.start or NO_TIME)
    for k, log in zip(dated, by_date, strict=True):
        logs[k] = log
    return [line for log in logs for line in log.lines]


def lines_of(text: str, file: str = "") -> list[TextLine]:
    """Lines of a text, comments after ; cut off."""
    return [
        TextLine(line.partition(";")[0], file, number, line)
        for number, line in enumerate(text.splitlines(), start=1)
    ]


class _Log(NamedTuple):
    """Lines of a file in the order of time, and the first time."""

    lines: list[TextLine]
    start: Stamp | None


def _is_in_time(lines: list[TextLine]) -> _Log:
    """The lines of a file, the oldest first. Raises InputError for times that jump."""
    stamps = {k: s for k, line in enumerate(lines) if (s := Stamp.leading(line.text))}
    starts, times = list(stamps), list(stamps.values())
    between = Stamp.steps(times)
    if not (between < 0.0).any():
        return _Log(lines, times[0] if times else None)
    if (between > 0.0).any():
        falls = lines[starts[1 + int(np.argmax(between < 0.0))]]
        raise falls.error(
            "the times of this log rise and fall, so that its order is not known",
            "give one session's lines, in the order of time, or the newest first",
        )
    ends = [*starts[1:], len(lines)]
    blocks = [lines[a:b] for a, b in zip(starts, ends, strict=True)]
    turned = [line for block in reversed(blocks) for line in block]
    return _Log([*lines[: starts[0]], *turned], times[-1])


def order_text(lines: Sequence[TextLine]) -> list[str]:
    """A sentence on each log that was turned round."""
    turned = [
        b.file
        for a, b in itertools.pairwise(lines)
        if a.file == b.file and a.number > b.number
    ]
    return [
        f"Order: in {Path(name).name} the newest line stands first, by its times; it is"
        " read from its end."
        for name in dict.fromkeys(turned)
    ]


def commands(lines: Iterable[TextLine], *names: str) -> Iterator[Command]:
    """Commands of these names, or all, in order."""
    for line in lines:
        for match in COMMAND.finditer(line.text):
            if not names or match[1] in names:
                # a host ends a command with * and a checksum
                pairs = WORD.findall(match[2])
                name = FILE_WORD.match(line.text, match.end(1))
                if name and match[1] in WITH_FILE:
                    pairs = [name.groups()]
                words = {letter: value.split("*")[0] for letter, value in pairs}
                yield Command(match[1], words, line)


def merged(lines: Sequence[TextLine], name: str, remedy: str) -> Command:
    """A setting command with the last value of every word. Raises InputError."""
    words: dict[str, str] = {}
    places: dict[str, TextLine] = {}
    last: Command | None = None
    for command in commands(lines, name):
        words |= command.words
        places |= dict.fromkeys(command.words, command.line)
        last = command
    if last is None:
        for line in lines:
            if REPETIER.search(line.text):
                raise line.error(*OF_REPETIER)
        raise InputError(f"no {name} in it", remedy, file=files_of(lines))
    return Command(name, words, last.line, places)


def optional(lines: Sequence[TextLine], name: str) -> Command:
    """The same, without words where the lines have no such command."""
    if any(commands(lines, name)):
        return merged(lines, name, "")
    return Command(name, {}, lines[0])


def files_of(lines: Sequence[TextLine]) -> str:
    """The files that lines are from, for an error."""
    return ", ".join(dict.fromkeys(line.file for line in lines))


def account_of(lines: Sequence[TextLine], table: WordTable) -> list[str]:
    """Sentences on what becomes of the words of all commands. Raises InputError."""
    names = [command.name for command in commands(lines)]
    return account(_written(lines, table), names, table)


def _written(lines: Sequence[TextLine], table: WordTable) -> Iterator[WrittenWord]:
    """Words of the commands in the table; "" stands for the command itself.

    A command without words in the table has no bearing on the geometry with any.
    """
    for command in commands(lines, *(name for name in table if table[name])):
        itself = {"": ""} if "" in table[command.name] else {}
        for letter, value in (itself | command.words).items():
            yield WrittenWord(
                command.name,
                letter,
                value,
                command.line.number,
                _word_error(command, letter),
            )


def _word_error(command: Command, letter: str) -> Callable[[str, str], InputError]:
    def error(problem: str, remedy: str) -> InputError:
        return command.line.error(problem, remedy, f"{command.name} {letter}".rstrip())

    return error


def finite(text: str, line: TextLine) -> float:
    """A number of a reply. Raises InputError."""
    value = plain_number(text)
    if value is None or not math.isfinite(value):
        raise line.error("not a finite number", "correct or remove the line", text)
    return value
