"""Values of a Klipper configuration with their lines, the saved block included.

Sections in brackets, `key: value` or `key = value`, comments after # or ;. The block that
SAVE_CONFIG writes at the end starts its lines with `#*#`. A value that stands above the
block as well wins over the saved one (`_strip_duplicates` of klippy/configfile.py).
Indented lines continue the value above them.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path

from pkm_studies import files
from pkm_studies.errors import InputError
from pkm_studies.importers.base import line_field

#: bytes of the largest configuration
LIMIT = 4_000_000
SAVED = "#*#"
SECTION = re.compile(r"\[\s*([^\]]+?)\s*\]\s*(?:[#;].*)?$")
OPTION = re.compile(r"([^\s:=#;\[][^:=]*?)\s*[:=]\s*(.*)$")
COMMENT = re.compile(r"#.*$|(?:^|\s);.*$")


@dataclasses.dataclass(frozen=True, slots=True)
class Entry:
    """A value as written, with its file and line."""

    text: str
    file: str
    line: int

    def error(self, option: str, problem: str, remedy: str) -> InputError:
        """The error to raise for this value."""
        field = line_field(self.line, option)
        return InputError(problem, remedy, file=self.file, field=field, value=self.text)


#: values by section and key
Entries = dict[tuple[str, str], Entry]


@dataclasses.dataclass
class _Parsed:
    """Options as written and as saved, and the headings of sections with their lines."""

    written: Entries = dataclasses.field(default_factory=dict)
    saved: Entries = dataclasses.field(default_factory=dict)
    sections: dict[str, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class KlipperConfig:
    """The options of one or more files, later ones winning; and those not in use.

    unused    saved values over which a written one wins
    sections  headings as written, with their lines
    """

    file: str
    entries: Entries
    unused: Entries
    sections: dict[str, int]

    def find(self, section: str, key: str) -> Entry | None:
        """The entry, or None."""
        return self.entries.get((section, key))

    def missing(self, section: str, key: str, remedy: str) -> InputError:
        """The error to raise for an entry that is not there."""
        place = f"[{section}] {key}"
        return InputError("missing", remedy, file=self.file, field=place)

    def number(self, section: str, key: str, default: float | None = None) -> float:
        """A finite number. Raises InputError."""
        entry = self.find(section, key)
        if entry is None:
            if default is not None:
                return default
            remedy = (
                "give the file that has it as well, where the configuration is spread"
                " over several: oed import klipper a.cfg b.cfg"
            )
            raise self.missing(section, key, remedy)
        return numbers(entry, f"[{section}] {key}", 1)[0]

    def positive(self, section: str, key: str, default: float | None = None) -> float:
        """A number above 0. Raises InputError."""
        value = self.number(section, key, default)
        entry = self.find(section, key)
        if value <= 0.0 and entry is not None:
            place = f"[{section}] {key}"
            raise entry.error(place, "it must be above 0", "correct it")
        return value

    def indices(self, section: str, pattern: str) -> list[int]:
        """Numbers i of the keys that a pattern with one group finds, in order."""
        keys = (key for name, key in self.entries if name == section)
        matches = (re.fullmatch(pattern, key) for key in keys)
        return sorted(int(match[1]) for match in matches if match)


def read(paths: Sequence[Path]) -> KlipperConfig:
    """The options of the files. Raises InputError."""
    parsed = _Parsed()
    for path in paths:
        text = files.read_text(path, limit=LIMIT, what="Klipper configuration")
        _parse(text, str(path), parsed)
    written, saved = parsed.written, parsed.saved
    unused = {key: saved[key] for key in saved.keys() & written.keys()}
    file = ", ".join(map(str, paths))
    return KlipperConfig(file, saved | written, unused, parsed.sections)


def numbers(entry: Entry, option: str, count: int) -> list[float]:
    """So many finite numbers, separated by commas. Raises InputError."""
    cells = entry.text.split(",")
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = "a number is" if count == 1 else f"{count} numbers are"
        raise entry.error(
            option, f"{wanted} wanted here", "correct it as Klipper has it"
        )
    return values


def _parse(text: str, file: str, parsed: _Parsed) -> None:
    """Add the options of a file."""
    section = ""
    last: tuple[Entries, tuple[str, str]] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        saved = line.startswith(SAVED)
        content = line[len(SAVED) :].removeprefix(" ") if saved else line
        indented = content[:1].isspace()
        content = COMMENT.sub("", content).strip()
        if indented:
            if last is not None and content:
                _continue(*last, content)
            continue
        heading = SECTION.match(content)
        if heading:
            parsed.sections[heading[1]] = number
            section, last = heading[1].lower(), None
            continue
        option = OPTION.match(content)
        if option and section:
            entries = parsed.saved if saved else parsed.written
            key = section, option[1].strip().lower()
            entries[key] = Entry(option[2].strip(), file, number)
            last = entries, key


def _continue(entries: Entries, key: tuple[str, str], content: str) -> None:
    """Add an indented line to a value."""
    entry = entries[key]
    text = f"{entry.text}\n{content}".strip()
    entries[key] = dataclasses.replace(entry, text=text)
