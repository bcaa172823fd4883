"""Candidates that stay on disk: NumPy files and memory-mapped arrays, and Arrow files.

Rows are read part by part as double precision. A part of a NumPy file is mapped alone, so that
the parts that were read before need no memory.
"""

from __future__ import annotations

import importlib
import io
import mmap
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from oed.base import Array, Index


class CandidateFile(Protocol):
    """Whitened, scaled candidates on disk."""

    def __len__(self) -> int:
        """Number of candidates C."""
        ...

    def read(self, begin: int, end: int) -> Array:
        """Blocks (end - begin, k, n) of consecutive candidates."""
        ...

    def take(self, chosen: Index) -> Array:
        """Blocks (m, k, n) of the chosen candidates."""
        ...


class NumpyCandidates:
    """Rows (C, n) or blocks (C, k, n) of a .npy file, or of any memory-mapped array."""

    def __init__(self, source: Path | np.memmap[Any, Any]) -> None:
        """Raises ValueError where it holds something else."""
        mapped: Any = source
        if isinstance(source, Path):
            mapped = np.load(source, mmap_mode="r")
        self._mapped: Any = mapped
        floating = np.issubdtype(mapped.dtype, np.floating)
        if mapped.ndim not in (2, 3) or not floating or not mapped.flags.c_contiguous:
            raise ValueError(
                "candidates must be rows (C, n) or blocks (C, k, n) of floating-point"
                f" numbers in C order, not {mapped.dtype} of shape {mapped.shape}"
            )

    def __len__(self) -> int:
        """Number of candidates C."""
        return len(self._mapped)

    def read(self, begin: int, end: int) -> Array:
        """Blocks (end - begin, k, n) of consecutive candidates."""
        whole = self._mapped
        if not self._is_whole:
            return _as_double(whole[begin:end])
        shape = (end - begin, *whole.shape[1:])
        offset = whole.offset + begin * self._row_bytes
        return _as_double(np.memmap(whole.filename, whole.dtype, "r", offset, shape))

    def take(self, chosen: Index) -> Array:
        """Blocks (m, k, n) of the chosen candidates.

        They are read one by one: a mapping would have whole pages around each in memory.
        """
        whole = self._mapped
        if not self._is_whole:
            return _as_double(whole[chosen])
        with Path(whole.filename).open("rb", buffering=0) as file:
            rows = [self._row(file, int(number)) for number in chosen]
        numbers = np.frombuffer(b"".join(rows), whole.dtype)
        return _as_double(numbers.reshape(-1, *whole.shape[1:]))

    def _row(self, file: io.FileIO, number: int) -> bytes:
        """Bytes of one candidate."""
        file.seek(self._mapped.offset + number * self._row_bytes)
        return file.read(self._row_bytes)

    @property
    def _row_bytes(self) -> int:
        return int(self._mapped.itemsize * np.prod(self._mapped.shape[1:]))

    @property
    def _is_whole(self) -> bool:
        """Whether the array is that of its file; a slice has the offset of the whole."""
        base = getattr(self._mapped, "base", None)
        return isinstance(base, mmap.mmap) and self._mapped.filename is not None


class ArrowCandidates:
    """Rows (C, n) of an Arrow IPC file: one column a parameter, one row a candidate."""

    def __init__(self, path: Path) -> None:
        """Raises ValueError without pyarrow, and where a column is no number."""
        try:
            arrow = importlib.import_module("pyarrow")
        except ImportError:
            raise ValueError(
                "Arrow files need pyarrow: pip install pkm-oed[parquet], or write a .npy"
                " file"
            ) from None
        source = arrow.memory_map(str(path))
        self._table = (
            importlib.import_module("pyarrow.ipc").open_file(source).read_all()
        )
        for field in self._table.schema:
            if not arrow.types.is_floating(field.type):
                raise ValueError(
                    f"column {field.name} holds {field.type}, not floating-point numbers"
                )

    def __len__(self) -> int:
        """Number of candidates C."""
        return int(self._table.num_rows)

    def read(self, begin: int, end: int) -> Array:
        """Blocks (end - begin, 1, n) of consecutive candidates."""
        return self._blocks(self._table.slice(begin, end - begin))

    def take(self, chosen: Index) -> Array:
        """Blocks (m, 1, n) of the chosen candidates."""
        return self._blocks(self._table.take(chosen))

    @staticmethod
    def _blocks(part: Any) -> Array:
        columns = [column.to_numpy() for column in part.columns]
        return _as_double(np.column_stack(columns))


def open_candidates(path: Path | str) -> CandidateFile:
    """The candidates of a .npy file or of an Arrow IPC file (.arrow, .feather).

    Raises ValueError for another suffix or content, OSError where it cannot be read.
    """
    path = Path(path)
    try:
        if path.suffix == ".npy":
            return NumpyCandidates(path)
        if path.suffix in (".arrow", ".feather"):
            return ArrowCandidates(path)
        raise ValueError("candidates are read from .npy, .arrow and .feather files")
    except (EOFError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error


def _as_double(rows: Any) -> Array:
    """Rows or blocks as blocks (m, k, n) of their own memory."""
    blocks = rows[:, None, :] if rows.ndim == 2 else rows
    return np.array(blocks, dtype=float, order="C")
