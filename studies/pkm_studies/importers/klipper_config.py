"""Values of a Klipper configuration with their lines, the saved block included.

Sections in brackets, `key: value` or `key = value`, comments after # or ;. The block that
SAVE_CONFIG writes at the end starts its lines with `#*#`. A value that stands above the
block as well wins over the saved one (`_strip_duplicates` of klippy/configfile.py).
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


@dataclasses.dataclass(frozen=True)
class KlipperConfig:
    """The options of one or more files, later ones winning; and those not in use.

    unused  saved values over which a written one wins
    """

    file: str
    entries: Entries
    unused: Entries

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
    written: Entries = {}
    saved: Entries = {}
    for path in paths:
        text = files.read_text(path, limit=LIMIT, what="Klipper configuration")
        above, block = _entries(text, str(path))
        written |= above
        saved |= block
    unused = {key: saved[key] for key in saved.keys() & written.keys()}
    return KlipperConfig(", ".join(map(str, paths)), saved | written, unused)


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


def _entries(text: str, file: str) -> tuple[Entries, Entries]:
    """Options as written and as saved; indented lines, which continue, are left out."""
    written: Entries = {}
    block: Entries = {}
    section = ""
    for number, line in enumerate(text.splitlines(), start=1):
        saved = line.startswith(SAVED)
        content = line[len(SAVED) :].removeprefix(" ") if saved else line
        if content[:1].isspace():
            continue
        content = COMMENT.sub("", content).rstrip()
        heading = SECTION.match(content)
        if heading:
            section = heading[1].lower()
            continue
        option = OPTION.match(content)
        if option and section:
            key = option[1].strip().lower()
            entries = block if saved else written
            entries[section, key] = Entry(option[2].strip(), file, number)
    return written, block
