"""Writes files whole or not at all, and reads text files of limited size."""

import codecs
import errno
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path

from oed.safe_files import write_together
from pkm_studies.base import InputError

#: what helps where the system refuses, by error number
REMEDIES = {
    errno.ENOSPC: "make room on this disk, or name a folder on another one",
    errno.EDQUOT: "remove files of yours from this disk, or name a folder on another one",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f), or ask who set it",
    errno.EROFS: "name a folder on a disk that can be written to",
}
OTHERWISE = (
    "check the name, its folder and its permissions, and close it in other programs"
)


def write_whole(path: Path, content: bytes | str) -> Path:
    """Write a file with all its bytes or not at all, and return its path.

    Its folder is made. Raises InputError where `path` is a folder or its folder cannot
    be made, OSError where the disk refuses.
    """
    return write_all({path: content})[0]


def write_all(contents: Mapping[Path, bytes | str]) -> tuple[Path, ...]:
    """Write files as `write_whole`, all of them or none, in this order; their paths."""
    for path in contents:
        if path.is_dir():
            raise InputError(
                "a folder of this name is in the way", "name a file", file=str(path)
            )
        make_folder(path.parent)
    encoded = {
        path: content.encode() if isinstance(content, str) else content
        for path, content in contents.items()
    }
    return write_together(encoded)


def refusal(error: OSError, further: str = "") -> InputError:
    """What the system refuses of a file, and what helps; `further` is said after it."""
    problem = (error.strerror or type(error).__name__).lower()
    remedy = REMEDIES.get(error.errno or 0, OTHERWISE) + further
    return InputError(problem, remedy, file=str(error.filename or "the system"))


def check_new(path: Path) -> None:
    """Raises InputError where `path` exists: nothing of the user's is overwritten."""
    if path.exists():
        problem = "there is a file of this name, and it is not overwritten"
        raise InputError(problem, "choose another name, or remove it", file=str(path))


def digest(content: bytes) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def make_folder(path: Path) -> Path:
    """Make a folder for results. Raises InputError where that is impossible."""
    check_writable(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def check_writable(path: Path) -> None:
    """Raises InputError where `path` cannot become a folder to write into."""
    ancestors = (path, *path.absolute().parents)
    nearest = next(folder for folder in ancestors if folder.exists())
    if not nearest.is_dir():
        problem = "a file of this name is in the way of a folder"
        raise InputError(problem, "name another folder", file=str(nearest))
    if not os.access(nearest, os.W_OK | os.X_OK):
        problem = "nothing can be written into this folder"
        raise InputError(problem, "name another folder", file=str(nearest))


def read_text(path: Path, *, limit: int, what: str, is_foreign: bool = False) -> str:
    """UTF-8 text of a regular file of at most `limit` bytes.

    A foreign file, of another program, may be UTF-16 with its mark or Windows-1252 as
    well: its numbers are the same. Raises InputError, before reading where the file is
    too large.
    """
    file = str(path)
    content = read_bytes(path, limit=limit, what=what)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        if not is_foreign or (b"\0" in content and not is_utf_16):
            problem = f"the file is no UTF-8 text (byte {error.start + 1})"
            raise InputError(problem, f"save the {what} as UTF-8", file=file) from None
        text = content.decode("utf-16" if is_utf_16 else "cp1252", errors="replace")
    if not text.strip():
        raise InputError("the file is empty", f"write a {what} into it", file=file)
    return text


def read_bytes(path: Path, *, limit: int, what: str) -> bytes:
    """Content of a regular file; InputError before reading more than `limit` bytes."""
    file = str(path)
    if not path.exists():
        remedy = "check the name and the folder you are in"
        raise InputError(f"there is no such {what}", remedy, file=file)
    if not path.is_file():
        raise InputError(
            f"a {what} is wanted, but this is no file", "name a file", file=file
        )
    size = path.stat().st_size
    if size > limit:
        remedy = (
            f"a {what} has at most {_megabytes(limit):.0f} MB: check that this is the"
            " right file"
        )
        problem = f"{_megabytes(size):.1f} MB is too large for a {what}"
        raise InputError(problem, remedy, file=file)
    return path.read_bytes()


def _megabytes(size: int) -> float:
    return size / 1e6
