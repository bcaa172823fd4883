"""Files that are written whole or not at all: a temporary file, renamed at the end.

A process that is killed leaves its temporary file. The next one that writes into the
folder removes it.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

#: this computer's sign in the names of temporary files: folders may be shared
HOST: Final = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
#: names of temporary files: name, computer, process
PART: Final = re.compile(r"\..+\.([0-9a-f]{8})-(\d+)\.part", re.DOTALL)
#: age from which a temporary file is left over, whichever computer wrote it, s
STALE: Final = 7 * 86400.0


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path next to `path` to write to; it takes the name at the end.

    Where the block fails or the user interrupts, `path` stays as it was and nothing
    half-written remains. Raises OSError, which always states the file.
    """
    with temporary_file(path) as part:
        yield part
        flush(part)
        part.replace(path)


@contextlib.contextmanager
def temporary_file(path: Path) -> Iterator[Path]:
    """A temporary path next to `path`, which is gone at the end unless it was renamed.

    Raises OSError about `path`: the user never sees the temporary name.
    """
    part = path.with_name(f".{path.name}.{HOST}-{os.getpid()}.part")
    _remove_stale(path.parent)
    try:
        yield part
    except OSError as error:
        if error.filename not in (None, str(part)):
            raise  # another file was refused
        raise _about(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@functools.lru_cache(maxsize=256)
def _remove_stale(folder: Path) -> None:
    """Remove temporary files in a folder whose process is gone; once a process."""
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder):
            name = PART.fullmatch(entry.name)
            if name is not None and _is_stale(entry, name[1], int(name[2])):
                Path(entry.path).unlink(missing_ok=True)


def _is_stale(entry: os.DirEntry[str], host: str, process: int) -> bool:
    if time.time() - entry.stat().st_mtime > STALE:
        return True
    return host == HOST and process != os.getpid() and not _runs(process)


def _runs(process: int) -> bool:
    """Whether a process of this computer runs; on Windows nobody asks."""
    if os.name == "nt":  # signal 0 is Ctrl-C there
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # of another user, or no process number
        return True
    return True


def flush(path: Path) -> None:
    """Wait until the disk holds the file."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _about(path: Path, error: OSError) -> OSError:
    """The error with the name of the file that was to be written.

    A full disk is reported without a name, and HDF5 reports it without a number.
    """
    reason = error.strerror or str(error) or "cannot be written"
    if PART.search(reason):
        reason = "cannot be written"
    return OSError(error.errno or 0, reason, str(path))
