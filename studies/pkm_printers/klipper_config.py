"""Values of a Klipper configuration with their lines, the saved block included.

Sections in brackets, `key: value` or `key = value`, comments after # or ;. Indented lines
continue the value above them. The block that SAVE_CONFIG writes at the end starts its
lines with `#*#`; a block that was edited is dropped as a whole (`_find_autosave_data` of
klippy/configfile.py), and so refused here. A value that stands above the block as well
wins over the saved one (`_strip_duplicates`).
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from pathlib import Path

from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.importers import line_field

#: bytes of the largest configuration
LIMIT = 4_000_000
SAVED = "#*#"
#: the lines with which the saved block begins
HEADER = (
    "#*# <---------------------- SAVE_CONFIG ---------------------->",
    "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.",
    "#*#",
)
DROPPED = (
    "Klipper drops the whole block of SAVE_CONFIG for this line, and uses none of it"
)
RESTORE = (
    "write the line as SAVE_CONFIG had it, {how}; or remove the block, and give the"
    " values that the printer uses"
)
SECTION = re.compile(r"\[([^\]]+)\]\s*(?:[#;].*)?$")
OPTION = re.compile(r"([^\s:=#;\[][^:=]*)[:=]\s*(.*)$")
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
        option = f"[{section}] {key}"
        return InputError("missing", remedy, file=self.file, field=option)

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
            option = f"[{section}] {key}"
            raise entry.error(option, "it must be above 0", "correct it")
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
        text = files.read_text(
            path, limit=LIMIT, what="Klipper configuration", is_foreign=True
        )
        _check_saved_block(text, str(path))
        _parse(text, str(path), parsed)
    written, saved = parsed.written, parsed.saved
    unused = {key: saved[key] for key in saved.keys() & written.keys()}
    file = ", ".join(map(str, paths))
    return KlipperConfig(file, saved | written, unused, parsed.sections)


def of_text(text: str) -> KlipperConfig:
    """The options of a text that has no saved block."""
    parsed = _Parsed()
    _parse(text, "", parsed)
    return KlipperConfig("", parsed.written, {}, parsed.sections)


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


def _check_saved_block(text: str, file: str) -> None:
    """Refuse a block of SAVE_CONFIG that Klipper drops. Raises InputError."""
    lines = text.splitlines()
    starts = (k for k in range(len(lines)) if tuple(lines[k : k + 3]) == HEADER)
    start = next(starts, None)
    if start is None:
        saved = [k for k, line in enumerate(lines) if line.startswith(f"{SAVED} ")]
        if saved:
            raise _dropped(lines, saved[0], file, "below its three lines of heading")
        return
    last = max(k for k, line in enumerate(lines) if line.strip())
    for number, line in enumerate(lines[: last + 1]):
        is_saved = line == SAVED or line.startswith(f"{SAVED} ")
        is_within = number >= start
        if is_within and not is_saved:
            raise _dropped(lines, number, file, f"beginning with {SAVED} and a blank")
        if line.startswith(f"{SAVED} ") and not is_within:
            raise _dropped(lines, number, file, "below the heading of the block")


def _dropped(lines: Sequence[str], number: int, file: str, how: str) -> InputError:
    return InputError(
        DROPPED,
        RESTORE.format(how=how),
        file=file,
        field=line_field(number + 1),
        value=lines[number].strip(),
    )


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
            parsed.sections[heading[1].strip()] = number
            section, last = heading[1].strip().lower(), None
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
