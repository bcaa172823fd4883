"""Files that are written whole or not at all: a temporary file, renamed at the end."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path next to `path` to write to; it takes the name at the end.

    Where the block fails or the user interrupts, `path` stays as it was and nothing
    half-written remains. Raises OSError, which always states the file.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        _flush(part)
        part.replace(path)
    except OSError as error:
        raise _about(path, error) from error
    finally:
        part.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Wait until the disk holds the file."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _about(path: Path, error: OSError) -> OSError:
    """The error with the name of the file that was to be written.

    A full disk is reported without a name, and HDF5 reports it without a number.
    """
    reason = error.strerror or str(error) or "cannot be written"
    return OSError(error.errno or 0, reason, str(path))
