"""Files, whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from pkm_studies.errors import InputError


def write_whole(path: Path, content: bytes | str) -> Path:
    """Write a file so that it is there with all its bytes or not at all; makes its
    folder; returns the path.

    Raises InputError where `path` is a folder or its folder cannot be made, OSError
    where the disk refuses.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    if path.is_dir():
        raise InputError(
            "a folder of this name is in the way", "name a file", file=str(path)
        )
    out_folder(path.parent)
    handle, name = tempfile.mkstemp(
        prefix=f".{path.name}.", suffix=".part", dir=path.parent
    )
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:  # also where the user interrupts: nothing half-written stays
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise
    return path


def out_folder(path: Path) -> Path:
    """Make a folder for results; raises InputError where that cannot be."""
    free(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def free(path: Path) -> None:
    """Raises InputError where `path` could not be a folder to write into. Makes
    nothing.
    """
    nearest = next(part for part in (path, *path.absolute().parents) if part.exists())
    if not nearest.is_dir():
        raise InputError(
            "a file of this name is in the way of a folder",
            "name another folder",
            file=str(nearest),
        )
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(
            "nothing can be written into this folder",
            "name another folder",
            file=str(nearest),
        )


def read_text(path: Path, *, limit: int, what: str) -> str:
    """UTF-8 text of a regular file of at most `limit` bytes. Raises InputError before
    reading a larger one.
    """
    if not path.exists():
        raise InputError(
            f"there is no such {what}",
            "check the name and the folder you are in",
            file=str(path),
        )
    if not path.is_file():
        raise InputError(
            f"this is no file, but a {what} is wanted",
            "name the file itself",
            file=str(path),
        )
    size = path.stat().st_size
    if size > limit:
        raise InputError(
            f"{size / 1e6:.1f} MB is too large for a {what}",
            f"a {what} has at most {limit / 1e6:.0f} MB: check that this is the right"
            " file",
            file=str(path),
        )
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"the file is no UTF-8 text (byte {error.start + 1})",
            f"save the {what} as UTF-8",
            file=str(path),
        ) from None
    if not text.strip():
        raise InputError("the file is empty", f"write a {what} into it", file=str(path))
    return text


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
