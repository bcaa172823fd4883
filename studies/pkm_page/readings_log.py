"""The readings file of a page: read with a version, and written whole, one row at a time.

Comments, separator, decimal sign, further columns and rows stay as the user wrote them.
A change states the version that it is based on, and is refused where the file has
another: two pages and an editor never overwrite each other. A reading that is undone
leaves its row, with the value in the row's remark.
"""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Final

from oed import csv_text
from oed.dataset import DECIMAL_COMMA, MAX_BYTES, ReadingsColumn, SplitText, decode
from pkm_studies import files
from pkm_studies.base import InputError

ABSENT: Final = "absent"  #: version of a file that is not there
REMARK: Final = "remark"
#: what a remark says before the value of a reading that was undone
UNDONE: Final = "undone"
VERSION_DIGITS: Final = 16  #: hexadecimal digits of a version


class StaleError(Exception):
    """The file has another version than the one that a change is based on."""


@dataclasses.dataclass(frozen=True)
class FileContent:
    """A readings file as it stands on the disk."""

    version: str  #: of its bytes
    above: str  #: text above the header, with a byte order mark where the file has one
    separator: str  #: between cells
    #: cells of all rows, the header first; none where there is no file
    rows: tuple[tuple[str, ...], ...]

    @property
    def header(self) -> list[str]:
        """Names of the columns."""
        return [name.strip() for name in self.rows[0]] if self.rows else []

    def cells(self, row: int) -> dict[str, str]:
        """Cells of a row of the table (1: the first below the header) by column."""
        return dict(zip(self.header, self.rows[row], strict=False))

    @property
    def text(self) -> str:
        """The text of the whole file."""
        written = io.StringIO(newline="")
        writer = csv.writer(written, delimiter=self.separator, lineterminator="\n")
        writer.writerows(self.rows)
        return self.above + written.getvalue()

    def replace_rows(self, rows: Sequence[Mapping[str, str]]) -> FileContent:
        """With rows at the end; a column that the header lacks is added to it."""
        header = self.header
        stems = {ReadingsColumn.stem_of(name): name for name in header}
        placed = [_cells_in_columns(row, stems) for row in rows]
        new = [
            n for n in dict.fromkeys(n for r in placed for n in r) if n not in header
        ]
        columns = [*header, *new]
        body = [(*row, *[""] * (len(columns) - len(row))) for row in self.rows[1:]]
        for row in placed:
            cells = [str(csv_text.safe(row.get(name, ""))) for name in columns]
            body.append(tuple(map(self._number, cells)))
        return dataclasses.replace(self, rows=(tuple(columns), *body))

    def replace_cells(self, row: int, cells: Mapping[str, str]) -> FileContent:
        """With other cells in a row of the table."""
        extended = self
        if any(name not in self.header for name in cells):
            extended = self.replace_rows([dict.fromkeys(cells, "")])
            extended = dataclasses.replace(extended, rows=extended.rows[:-1])
        changed = {**extended.cells(row), **cells}
        line = tuple(str(csv_text.safe(changed.get(n, ""))) for n in extended.header)
        rows = (*extended.rows[:row], line, *extended.rows[row + 1 :])
        return dataclasses.replace(extended, rows=rows)

    def _number(self, cell: str) -> str:
        commas = self.separator != "," and any(
            DECIMAL_COMMA.fullmatch(c.strip()) for r in self.rows[1:] for c in r
        )
        try:
            float(cell)
        except ValueError:
            return cell
        return cell.replace(".", ",") if commas else cell


def parse(data: bytes) -> FileContent:
    """The content of a file's bytes. Raises InputError where it is no table."""
    version = files.digest(data)[:VERSION_DIGITS]
    try:
        text = decode(data)
        split = SplitText.of(text)
        lines = csv.reader(
            io.StringIO(split.text, newline=""), delimiter=split.separator, strict=True
        )
        rows = tuple(tuple(cells) for cells in lines if any(map(str.strip, cells)))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"the readings cannot be read: {error}", "save them as CSV in UTF-8"
        ) from error
    mark = "\ufeff" if data.startswith(b"\xef\xbb\xbf") else ""
    above = mark + text[: len(text) - len(split.text)]
    return FileContent(version, above, split.separator, rows)


class ReadingsLog:
    """A readings file that several may write to."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> FileContent:
        """The file as it is now. Raises InputError, and OSError as the disk does."""
        try:
            with self.path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            return FileContent(ABSENT, "", ",", ())
        if len(data) > MAX_BYTES:
            raise InputError(
                "the file is too large", "name another", file=str(self.path)
            )
        return parse(data)

    def write(self, base: str, content: FileContent) -> FileContent:
        """Write a content based on a version, whole, to the disk. Raises StaleError."""
        data = content.text.encode("utf-8")
        files.make_folder(self.path.parent)
        with _exclusive(self.path):
            if self.read().version != base:
                raise StaleError
            files.write_whole(self.path, data)
            _flush_folder(self.path.parent)
        return parse(data)


def _cells_in_columns(
    row: Mapping[str, str], stems: Mapping[str, str]
) -> dict[str, str]:
    """Cells by the names that a file has for their stems, in its units."""
    placed = {}
    for name, cell in row.items():
        column = stems.get(ReadingsColumn.stem_of(name), name)
        if column != name and cell:
            factor = (
                ReadingsColumn.parse(name).factor / ReadingsColumn.parse(column).factor
            )
            cell = f"{float(cell) * factor:.15g}"
        placed[column] = cell
    return placed


@contextlib.contextmanager
def _exclusive(path: Path) -> Iterator[None]:
    """Keep other servers of this computer from writing; the system frees a dead one's."""
    lock = path.with_name(f".{path.name}.lock")
    with lock.open("a+b") as file:
        _lock(file)
        yield


def _lock(file: IO[bytes]) -> None:
    """Wait for a file; closing it frees it."""
    if os.name == "nt":
        import msvcrt

        file.seek(0)
        msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)  # type: ignore[attr-defined,unused-ignore]
    else:
        import fcntl

        fcntl.flock(file.fileno(), fcntl.LOCK_EX)


def _flush_folder(folder: Path) -> None:
    """Wait until the disk holds the folder's entry of a renamed file."""
    if os.name == "nt":  # folders cannot be opened there
        return
    entry = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(entry)
    finally:
        os.close(entry)
