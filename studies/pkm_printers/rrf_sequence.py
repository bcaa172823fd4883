"""Lines of RepRapFirmware's files in the order in which the firmware executes them.

`config.g` comes first, with `config-override.g` where M501 reads it, then the files that
have the probe points. Answers in logs are those of the firmware after its configuration.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from pkm_printers import gcode
from pkm_printers.gcode import Command, TextLine
from pkm_printers.words import (
    HARMLESS,
    READ,
    Use,
    Word,
    WordTable,
    cost_sentence,
    costs,
    refused,
    same,
)
from pkm_studies.base import InputError

#: a line that begins with a command, and one that is nothing else, in any letters
CODE = re.compile(r"\s*(?:[Nn]\d+\s+)?[GgMm]\d")
TYPED = re.compile(r"\s*[GgMm]\d+(?:\s+[A-Za-z][-+.:\d]*)*\s*")
#: texts and expressions, whose letters stay
VERBATIM = re.compile(r'("[^"]*"|\{[^{}]*\})')
#: the letter of an exponent, which is no word
EXPONENT = re.compile(r"(?<=[\d.])E(?=[-+]?\d)")
#: conditions and loops: the lines further in are executed or not
BLOCK = re.compile(r"\s*(if|elif|else|while)\b")
OVERRIDE = "config-override"
NO_OVERRIDE = (
    "it reads config-override.g, whose M665 and M666 win: give that file as well, where"
    " the printer has one"
)
NOT_LOADED = (
    "no M501 is in the other files, so the firmware does not read this one",
    "leave it out, or give the file that has M501",
)
CONDITION = "what is executed on a condition, or several times, is not known here"
NO_CONDITION = "write the lines that the firmware executes without it, in a copy"


@dataclasses.dataclass(frozen=True)
class ExecutionOrder:
    """Lines in the order of the firmware."""

    settings: list[TextLine]  #: of configuration and logs
    probing: list[TextLine]  #: of the files that have the probe points
    #: name of the file of stored values that the firmware reads; None without
    stored: str | None
    notes: list[str]  #: sentences on what is not read

    @property
    def lines(self) -> list[TextLine]:
        """All lines."""
        return [*self.settings, *self.probing]


def execution_order(lines: Sequence[TextLine], words: WordTable) -> ExecutionOrder:
    """The lines of all files in order, commands in capitals. Raises InputError."""
    files: dict[str, list[TextLine]] = {}
    for line in lines:
        files.setdefault(line.file, []).append(capitals(line))
    code = {name: content for name, content in files.items() if _is_code(name)}
    notes = [_conditions(content, words) for content in code.values()]
    stored = {
        name: content
        for name, content in code.items()
        if Path(name).name.lower().startswith(OVERRIDE)
    }
    probing = {
        name for name, content in files.items() if _has_points(content)
    } - stored.keys()
    configuration = [
        line
        for name, content in code.items()
        if name not in stored and name not in probing
        for line in content
    ]
    logs = [
        line
        for name, content in files.items()
        if name not in code and name not in probing
        for line in content
    ]
    settings = _add_stored(configuration, stored, logs)
    if not stored:
        notes.append(_unread(configuration))
    return ExecutionOrder(
        settings=[*settings, *logs],
        probing=[line for name in files if name in probing for line in files[name]],
        stored=next((Path(name).name for name in stored), None),
        notes=[note for note in notes if note],
    )


def capitals(line: TextLine) -> TextLine:
    """The line with its commands in capitals; of a log, where it is nothing else."""
    has_code = CODE.match if _is_code(line.file) else TYPED.fullmatch
    if not has_code(line.text):
        return line
    parts = VERBATIM.split(line.text)
    upper = [p if k % 2 else p.upper() for k, p in enumerate(parts)]
    text = EXPONENT.sub("e", "".join(upper))
    return dataclasses.replace(line, text=text)


def _is_code(file: str) -> bool:
    return file.lower().endswith(".g")


def _has_points(lines: Sequence[TextLine]) -> bool:
    return any("P" in command.words for command in gcode.commands(lines, "G30"))


def _add_stored(
    configuration: Sequence[TextLine],
    stored: Mapping[str, Sequence[TextLine]],
    logs: Sequence[TextLine],
) -> list[TextLine]:
    """The configuration with what M500 stored after each M501. Raises InputError."""
    values = [line for content in stored.values() for line in content]
    if not values or not configuration:
        return [*values, *configuration]
    merged: list[TextLine] = []
    for line in configuration:
        merged.append(line)
        if any(gcode.commands([line], "M501")):
            merged += values
    if len(merged) == len(configuration):
        if not any(gcode.commands(logs, "M501")):
            problem, remedy = NOT_LOADED
            raise InputError(problem, remedy, file=next(iter(stored)))
        merged += values
    return merged


def _unread(configuration: Sequence[TextLine]) -> str:
    """A sentence on stored values that the firmware reads, and that were not given."""
    reads = list(gcode.commands(configuration, "M501"))
    if not reads:
        return ""
    return cost_sentence({"M501": reads[-1].line.number}, NO_OVERRIDE)


def _conditions(lines: Sequence[TextLine], words: WordTable) -> str:
    """A sentence on conditions and loops. Raises InputError for those of the geometry."""
    blocks: dict[str, int] = {}
    opening: list[TextLine] = []
    repeated: list[TextLine] = []
    for line in lines:
        if not line.text.strip():
            continue
        opening = [o for o in opening if _indent(o) < _indent(line)]
        if opening and _is_repeated_point(line, opening):
            repeated.append(line)
        elif opening:
            _check_harmless(line, opening[-1], words)
        match = BLOCK.match(line.text)
        if match:
            opening.append(line)
            blocks[f"{match[1]} (line {line.number})"] = line.number
    if not blocks:
        return ""
    again = ""
    if repeated:
        again = (
            f"Points of lines {repeated[0].number} to {repeated[-1].number} stand in a"
            " loop, which probes them anew; the heights are those of its last pass. "
        )
    return (
        f"{again}Not read, no part of the geometry: what stands under"
        f" {', '.join(blocks)} of {Path(lines[0].file).name}."
    )


def _is_repeated_point(line: TextLine, opening: Sequence[TextLine]) -> bool:
    """Whether a line is a point of G30 in loops alone, at one place in every pass."""
    is_loop = all(o.text.lstrip().startswith("while") for o in opening)
    return is_loop and "{" not in line.text and _has_points([line])


def _check_harmless(line: TextLine, opening: TextLine, words: WordTable) -> None:
    """Refuse a command that is part of the geometry. Raises InputError."""
    for command in gcode.commands([line]):
        if command.name == "M501" or any(_read_words(command, words)):
            text = opening.text.strip()
            raise line.error(
                f"it stands under {text!r} of line {opening.number}: {CONDITION}",
                NO_CONDITION,
                command.name,
            )


def _read_words(command: Command, words: WordTable) -> Iterator[str]:
    """Letters of a command that are read."""
    table = words.get(command.name, {})
    for letter in command.words:
        word = table.get(letter)
        if word is not None and word.use is Use.READ:
            yield letter


def _indent(line: TextLine) -> int:
    text = line.text.expandtabs(8)
    return len(text) - len(text.lstrip())


# Words of RepRapFirmware that bear on a delta and its probe, with what is done with them.
#
# After the G-code dictionary of RepRapFirmware 1 to 3 and its LinearDeltaKinematics.

MORE_TOWERS: Final = refused(
    "this sets towers beyond the third", "remove it: only three towers hold the tool"
)
IN_HEIGHTS: Final = costs(
    "the heights of the log are without it already; an error of it moves all of z"
)
HEIGHT_MAP: Final = costs(
    "a height map that is on bends z, also after calibration: turn it off (M561) before you"
    " probe, and probe it anew after"
)
RADII: Final = refused(
    "forks of the firmware mean trims of the towers' radii, or of their angles, by it",
    "remove it and add a line radius_trim_mm = x, y, z with the radius trims of the"
    " towers; where they are angles, add them to M665 X, Y, Z",
)

M665: Final[dict[str, Word]] = {
    **same(READ, "LRHBXYZ"),
    **same(RADII, "ACDEFIJK"),
    "S": HARMLESS,
}
M666: Final[dict[str, Word]] = {**same(READ, "XYZAB"), **same(MORE_TOWERS, "UVW")}
G30: Final[dict[str, Word]] = {
    **same(READ, "PXYZK"),
    "H": costs("the heights of the log are without it already"),
    "S": costs(
        "above 0 the firmware calibrates itself from the heights; give the geometry that"
        " it had before"
    ),
}
G31: Final[dict[str, Word]] = {
    **same(READ, "XYK"),
    "Z": IN_HEIGHTS,
    **same(HARMLESS, "PUVWABD"),
    **same(
        costs("the trigger height follows the temperature, which is not modelled"),
        "CSHT",
    ),
}
WORDS: Final[WordTable] = {
    "M665": M665,
    "M666": M666,
    "M669": {"K": READ, **same(HARMLESS, "ST"), **same(MORE_TOWERS, "XY")},
    "M557": same(
        costs("it is the grid of G29; the points of G30 are read"), "XYRSPABCUVW"
    ),
    "M558": {**same(HARMLESS, "CHFTABRSIXYZUVLE"), **same(READ, "PK")},
    "M851": {"Z": IN_HEIGHTS},
    "G30": G30,
    "G31": G31,
    "M92": same(
        costs("steps per mm are taken as right: an error scales the towers' travel"),
        "XYZUVWABCDES",
    ),
    "M579": same(
        costs("the firmware scales x, y and z by it, which the study does not know"),
        "XYZUVW",
    ),
    "M556": same(
        costs("the firmware corrects skew by it, which the study does not know"),
        "SXYZP",
    ),
    "G10": same(
        costs("offsets of a tool move the places of probing where one is selected"),
        "PLXYZUVWRSABCDE",
    ),
    "M98": same(costs("this file may hold further settings: give it too"), "PRXYZSFH"),
    "G20": {"": refused("the numbers are in inches", "give them in mm")},
    "G29": same(HEIGHT_MAP, "SPK"),
    "M375": same(HEIGHT_MAP, "P"),
    # answers of the firmware, and what has no bearing on geometry
    **{name: {} for name in ("G28", "G32", "M500", "M501", "M503", "M561", "M115")},
}
