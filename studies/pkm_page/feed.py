"""Readings that arrive as lines: of a followed file, a folder, a serial line, a TCP port.

A regular expression turns a line into numbers. Its groups have the names of columns, unit
included, as in `(?P<length_mm>[-+0-9.]+)`. Without one, a followed file is a CSV whose
header names the columns.
"""

import csv
import dataclasses
import functools
import io
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from oed import units
from oed.dataset import ReadingsColumn
from pkm_page import typed
from pkm_studies.base import InputError

PAUSE = 0.3  #: time between two looks at a file, s
AGAIN = 2.0  #: time before a lost line is opened again, s
MAX_LINE_BYTES: Final = 4000  #: bytes of a line, and of what is read at a time
MAX_STREAM_BYTES: Final = 4_000_000
END: Final = re.compile(rb"\r\n|\r|\n")  #: what ends a line
BAUD: Final = 9600
BYTE_ORDER_MARK: Final = b"\xef\xbb\xbf"
#: said until a whole line came: a connection may join in the midst of one
JOINED: Final = (
    "The first line after a connection does not count: its beginning was not seen"
)
TCP, SERIAL = "tcp://", "serial:"  #: beginnings of sources that are no files


@dataclasses.dataclass(frozen=True)
class Offer:
    """Numbers that arrived, by stem, SI; `number` counts the lines that gave some."""

    number: int
    values: dict[str, float]


class Feed:
    """A source of lines, read in a thread of its own.

    source   `tcp://HOST:PORT`, `serial:DEVICE[,BAUD]`, a file or a folder
    pattern  regular expression with a group for each column; empty: a CSV
    arrived  called with each offer

    Raises InputError for a source or a pattern that cannot be used.
    """

    def __init__(
        self, source: str, pattern: str, arrived: Callable[[Offer], None]
    ) -> None:
        self.source, self.arrived = source, arrived
        self.pattern = _compiled(pattern)
        is_line = source.startswith((TCP, SERIAL))
        if self.pattern is None and is_line:
            example = "as in --pattern '(?P<length_mm>[-+0-9.]+)'"
            raise _refusal("a line needs a pattern", example, source)
        self._lines = _opener(source, self.pattern is None)
        self._first = JOINED if is_line else ""
        self.number = 0
        self.problem = ""

    def start(self) -> None:
        """Read from now on, until the process ends."""
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            self.problem = self.problem or self._first
            try:
                for line in self._lines():
                    self.problem = ""
                    self.take_line(line)
            except OSError as error:
                self.problem = f"{self.source}: {error.strerror or error}: tried again"
            time.sleep(AGAIN)

    def take_line(self, line: str) -> None:
        """Offer the numbers of a line, if it has all of them."""
        if any(len(part) > MAX_LINE_BYTES for part in line.split("\n")):
            self.problem = f"A line of more than {MAX_LINE_BYTES} bytes is passed over"
            return
        values = _row_values(line) if self.pattern is None else self._match(line)
        if values:
            self.number += 1
            self.arrived(Offer(self.number, values))

    def _match(self, line: str) -> dict[str, float]:
        match = None if self.pattern is None else self.pattern.search(line)
        return {} if match is None else _si_values(match.groupdict())


def _compiled(pattern: str) -> re.Pattern[str] | None:
    if not pattern:
        return None
    try:
        compiled = re.compile(pattern)
        for name in compiled.groupindex:
            ReadingsColumn.parse(name)
        if not compiled.groupindex:
            raise units.UnitError("no group says which column a number belongs to")
    except (re.error, units.UnitError) as error:
        remedy = "name groups as columns with their unit: (?P<length_mm>[-+0-9.]+)"
        problem = str(error)
        raise InputError(problem, remedy, field="--pattern", value=pattern) from error
    return compiled


def _refusal(problem: str, remedy: str, source: str) -> InputError:
    """The error about a source that cannot be used."""
    return InputError(problem, remedy, field="--from", value=source)


def _si_values(cells: dict[str, str | None]) -> dict[str, float]:
    """Numbers by stem, SI; none where a cell is no number."""
    values = {}
    for name, cell in cells.items():
        try:
            column = ReadingsColumn.parse(name)
            values[column.stem] = typed.read(cell or "", name) * column.factor
        except (InputError, units.UnitError):
            return {}
    return values


def _row_values(pair: str) -> dict[str, float]:
    """Numbers of a CSV's row below its header; columns without a known unit are left out."""
    rows = list(csv.reader(io.StringIO(pair), delimiter=";" if ";" in pair else ","))
    if len(rows) != 2 or len(rows[0]) != len(rows[1]):
        return {}
    values: dict[str, float] = {}
    for name, cell in zip(rows[0], rows[1], strict=True):
        values |= _si_values({name.strip(): cell})
    return values


def _opener(source: str, is_table: bool) -> Callable[[], Iterator[str]]:
    """What opens a source, which may be lost and opened again. Raises InputError."""
    if source.startswith(TCP):
        return functools.partial(_tcp_lines, _tcp_address(source))
    if source.startswith(SERIAL):
        return functools.partial(_serial_lines, *_serial_port(source))
    return functools.partial(_file_lines, _existing(source), is_table)


def _existing(source: str) -> Path:
    path = Path(source)
    if not path.exists():
        remedy = "check the name; lines are tcp://HOST:PORT or serial:DEVICE"
        raise _refusal("there is no such file or folder", remedy, source)
    return path


def _file_lines(path: Path, is_table: bool) -> Iterator[str]:
    """Whole lines of a file, or of new files, from now on; of a table below its header."""
    lengths = {file: file.stat().st_size for file in _files(path)}
    while True:
        for file in _files(path):
            size = file.stat().st_size
            before = lengths.get(file, 0)
            if size == before:
                continue
            lines, lengths[file] = _new_lines(file, before if size > before else 0)
            header = _new_lines(file, 0)[0][:1] if is_table and lines else []
            for line in lines:
                if line not in header:
                    yield "\n".join([*header, line])
        time.sleep(PAUSE)


def _new_lines(file: Path, start: int) -> tuple[list[str], int]:
    """Whole lines of a file from a position on, and the position after them.

    The byte before tells whether the position is in the midst of a line, which then does
    not count: it was begun before anybody looked, or the file is another one by now.
    """
    before = max(start - 1, 0)
    with file.open("rb") as stream:
        stream.seek(before)
        data = stream.read(MAX_STREAM_BYTES)
    ends = [match.end() for match in END.finditer(data)]
    if not ends and len(data) == MAX_STREAM_BYTES:  # one line, too long to be kept
        return [data[: MAX_LINE_BYTES + 1].decode("latin-1")], start + len(data)
    lines = LineBuffer(begins=start == 0).add(data.removeprefix(BYTE_ORDER_MARK))
    return list(lines), max(start, before + max(ends, default=0))


class LineBuffer:
    """The lines of bytes that arrive in parts: those whose beginning and end were seen.

    begins  whether the first byte begins a line
    """

    def __init__(self, *, begins: bool) -> None:
        self._part = b""
        self._begins = begins

    def add(self, data: bytes) -> Iterator[str]:
        """The lines that end here, without blanks around; of longer ones the beginning."""
        *ended, part = END.split(self._part + data)
        for line in ended:
            text = line[: MAX_LINE_BYTES + 1].decode("utf-8", "replace").strip()
            if self._begins and text:
                yield text
            self._begins = True
        self._part = part[: MAX_LINE_BYTES + 1]


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(p for p in path.iterdir() if p.is_file() and p.name[:1] != ".")
    return [path] if path.exists() else []


def _tcp_address(source: str) -> tuple[str, int]:
    host, _, port = source.removeprefix(TCP).rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise _refusal("no address", "as in tcp://192.168.0.7:5000", source)
    return host, int(port)


def _tcp_lines(address: tuple[str, int]) -> Iterator[str]:
    with socket.create_connection(address, timeout=10.0) as connection:
        connection.settimeout(None)
        lines = LineBuffer(begins=False)
        while data := connection.recv(MAX_LINE_BYTES):
            yield from lines.add(data)


def _serial_port(source: str) -> tuple[str, int]:
    device, _, baud = source.removeprefix(SERIAL).partition(",")
    if not device or (baud and not baud.isdigit()):
        raise _refusal("no device", "as in serial:/dev/ttyUSB0,9600", source)
    try:
        import serial  # noqa: F401
    except ModuleNotFoundError as error:
        problem = "serial lines need the package pyserial"
        raise _refusal(problem, "pip install 'pkm-oed[serial]'", source) from error
    return device, int(baud or BAUD)


def _serial_lines(device: str, baud: int) -> Iterator[str]:
    import serial

    with serial.Serial(device, baud) as port:
        lines = LineBuffer(begins=False)
        while data := port.read(port.in_waiting or 1):
            yield from lines.add(data)
