"""Values of a Klipper configuration with their lines, the saved block included.

Sections in brackets, `key: value` or `key = value`, comments after # or ;. Indented lines
continue the value above them. The block that SAVE_CONFIG writes at the end starts its
lines with `#*#`; a block that was edited is dropped as a whole (`_find_autosave_data` of
klippy/configfile.py), and so refused here. A value that stands above the block as well
wins over the saved one (`_strip_duplicates`).
"""

import dataclasses
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from oed.base import Array, Mask
from pkm_printers.bed_mesh import BedMesh, copied_margin
from pkm_printers.delta_study import Offset
from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.importers import line_field

MAX_BYTES = 4_000_000  #: bytes of the largest configuration
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


Entries = dict[tuple[str, str], Entry]  #: values by section and key


@dataclasses.dataclass
class _Parsed:
    """Options as written and as saved, and the headings of sections with their lines."""

    written: Entries = dataclasses.field(default_factory=dict)
    saved: Entries = dataclasses.field(default_factory=dict)
    sections: dict[str, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class KlipperConfig:
    """The options of one or more files, later ones winning; and those not in use."""

    file: str
    entries: Entries
    unused: Entries  #: saved values over which a written one wins
    sections: dict[str, int]  #: headings as written, with their lines

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
            path, limit=MAX_BYTES, what="Klipper configuration", is_foreign=True
        )
        _check_saved_block(text, str(path))
        _parse(text, str(path), parsed)
    written, saved = parsed.written, parsed.saved
    unused = {key: saved[key] for key in saved.keys() & written.keys()}
    file = ", ".join(map(str, paths))
    return KlipperConfig(file, saved | written, unused, parsed.sections)


def parse_options(text: str) -> KlipperConfig:
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
            section = heading[1].strip().lower()
            last = None
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


# Klipper: the saved profiles of [bed_mesh], as heights of the nozzle at contact.
#
# A profile's places are those of the probe, its heights those of the nozzle less the
# probe's z_offset (`probe_finalize` in klippy/extras/bed_mesh.py). On a round bed a row
# is filled up with its first and last probed height. Nodes in a faulty region were probed
# beside it.

PREFIX: Final = "bed_mesh "
PROBES: Final = ("probe", "bltouch", "smart_effector")
#: options of any other section that is a probe: [scanner], [probe_eddy_current x]
OFFSETS: Final = ("x_offset", "y_offset")
REMEDY: Final = "import the profile as SAVE_CONFIG wrote it, or remove it"
MAX_MESH_HEIGHT_MM: Final = 100.0  #: mm; no mesh has a larger height
MARGIN: Final = "the firmware filled them up from probed ones"


def meshes(config: KlipperConfig) -> list[BedMesh]:
    """The saved profiles, in the file's order. Raises InputError."""
    sections = dict.fromkeys(
        name for name, _ in config.entries if name.startswith(PREFIX)
    )
    return [_mesh(config, section) for section in sections]


def _mesh(config: KlipperConfig, section: str) -> BedMesh:
    z = _heights(config, section)
    x = _places(config, section, "x", z.shape[1])
    y = _places(config, section, "y", z.shape[0])
    margin = copied_margin(x, y, z)
    if config.find("bed_mesh", "mesh_radius") is not None and not margin.any():
        entry = config.entries[section, "points"]
        raise entry.error(
            f"[{section}] points",
            "nodes beyond [bed_mesh] mesh_radius have heights of their own, where Klipper"
            " probes none: a fork's nodes are elsewhere",
            "remove the profile from a copy of the file",
        )
    unread = margin | _is_in_faulty_region(config, x, y)
    z = np.where(unread, np.nan, z)
    name = section.removeprefix(PREFIX).strip()
    return BedMesh.of_grid(name, x, y, z, probe_offset(config), MARGIN)


def _heights(config: KlipperConfig, section: str) -> Array:
    """Heights (ny, nx), mm. Raises InputError."""
    entry = config.find(section, "points")
    if entry is None:
        raise config.missing(section, "points", REMEDY)
    count = round(config.positive(section, "x_count"))
    rows = [line for line in entry.text.splitlines() if line.strip()]
    if len(rows) != round(config.positive(section, "y_count")):
        problem = f"{len(rows)} rows, where y_count has another number"
        raise entry.error(f"[{section}] points", problem, REMEDY)
    option = f"[{section}] points"
    written = [Entry(row, entry.file, entry.line) for row in rows]
    heights = np.array([numbers(row, option, count) for row in written])
    if np.abs(heights).max() > MAX_MESH_HEIGHT_MM:
        problem = f"no bed is {np.abs(heights).max():.3g} mm uneven"
        raise entry.error(option, problem, REMEDY)
    return heights


def _places(config: KlipperConfig, section: str, axis: str, count: int) -> Array:
    low = config.number(section, f"min_{axis}")
    high = config.number(section, f"max_{axis}")
    if low >= high or count < 2:
        entry = config.entries[section, f"max_{axis}"]
        problem = "the mesh has no width"
        raise entry.error(f"[{section}] max_{axis}", problem, REMEDY)
    return np.linspace(low, high, count)


def probe_offset(config: KlipperConfig) -> Offset:
    """Place (2,) of the probe from the nozzle, mm; 0 without a probe of its own place."""
    return probe_number(config, "x_offset", 0.0), probe_number(config, "y_offset", 0.0)


def probe_number(config: KlipperConfig, key: str, default: float) -> float:
    """A number of the section of the probe."""
    for section in (*PROBES, *other_probes(config)):
        if config.find(section, key) is not None:
            return config.number(section, key)
    return default


def other_probes(config: KlipperConfig) -> list[str]:
    """Sections of other names that say where a probe is."""
    stated = (section for section, key in config.entries if key in OFFSETS)
    return [section for section in dict.fromkeys(stated) if section not in PROBES]


def _is_in_faulty_region(config: KlipperConfig, x: Array, y: Array) -> Mask:
    """Which nodes (ny, nx) lie in a faulty region of [bed_mesh]."""
    inside = np.zeros((len(y), len(x)), dtype=bool)
    for low, high in _faulty_regions(config):
        across = (x >= low[0]) & (x <= high[0])
        along = (y >= low[1]) & (y <= high[1])
        inside |= along[:, None] & across[None, :]
    return inside


def _faulty_regions(config: KlipperConfig) -> Iterator[tuple[list[float], list[float]]]:
    """Two corners (2,), mm, of each region."""
    for section, key in config.entries:
        match = re.fullmatch(r"faulty_region_(\d+)_min", key)
        if section != "bed_mesh" or match is None:
            continue
        corners = []
        for end in ("min", "max"):
            option = f"faulty_region_{match[1]}_{end}"
            entry = config.find(section, option)
            if entry is None:
                raise config.missing(section, option, "give both corners of the region")
            corners.append(numbers(entry, f"[{section}] {option}", 2))
        yield corners[0], corners[1]
