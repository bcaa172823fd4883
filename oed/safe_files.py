"""Files written whole, replaced only while nobody changed them, and private folders.

A file is written under a temporary name, and renamed at the end. A process that is killed
leaves its temporary file; the next one that writes into the folder removes it. A hidden
list in the folder has the digests of what the program wrote. A file that the user changed
stays, and the new one gets a number, as in `report-2.html`; so does a file that nobody
listed.
"""

import contextlib
import functools
import hashlib
import itertools
import json
import os
import re
import socket
import stat
import time
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Final

#: this computer's sign in the names of temporary files: folders may be shared
HOST_MARK: Final = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]
#: names of temporary files: name, computer, process
PART_NAME: Final = re.compile(r"\..+\.([0-9a-f]{8})-(\d+)\.part", re.DOTALL)
#: age from which a temporary file is left over, whichever computer wrote it, s
STALE_AGE: Final = 7 * 86400.0
#: the list: SHA-256 of the last contents by name, the file written last at the end
LIST_NAME: Final = ".oed-files.json"
MAX_LIST_BYTES: Final = 4_000_000  #: bytes of the largest list that is read
ROOT_USER: Final = 0  #: number of the administrator


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
    """A path next to `path`, gone at the end unless renamed. OSError."""
    part = path.with_name(f".{path.name}.{HOST_MARK}-{os.getpid()}.part")
    _remove_stale(path.parent)
    try:
        yield part
    except OSError as error:
        if error.filename not in (None, str(part)):
            raise  # another file was refused
        raise _named_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@functools.lru_cache(maxsize=256)
def _remove_stale(folder: Path) -> None:
    """Remove temporary files in a folder whose process is gone; once a process."""
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder):
            name = PART_NAME.fullmatch(entry.name)
            if name is not None and _is_stale(entry, name[1], int(name[2])):
                Path(entry.path).unlink(missing_ok=True)


def _is_stale(entry: os.DirEntry[str], host: str, process: int) -> bool:
    if time.time() - entry.stat().st_mtime > STALE_AGE:
        return True
    return host == HOST_MARK and process != os.getpid() and not _runs(process)


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


def write_together(contents: Mapping[Path, bytes]) -> tuple[Path, ...]:
    """Write all files or none, in this order; their paths. Raises OSError."""
    parts = {}
    with contextlib.ExitStack() as opened:
        for path, content in contents.items():
            part = opened.enter_context(temporary_file(path))
            part.write_bytes(content)
            flush(part)
            parts[part] = path
        for part, path in parts.items():
            part.replace(path)
    return tuple(contents)


def _named_error(path: Path, error: OSError) -> OSError:
    """The error with the file's name: a full disk has none, of HDF5 no number."""
    reason = error.strerror or str(error) or "cannot be written"
    if PART_NAME.search(reason):
        reason = "cannot be written"
    return OSError(error.errno or 0, reason, str(path))


def write_own(path: Path, content: bytes, replaceable: Collection[str] = ()) -> Path:
    """Write a file whole, and return its path: `path`, or one with a number unless its
    digest is `replaceable`. Raises OSError.
    """
    with temporary_file(path) as part:
        part.write_bytes(content)
        flush(part)
        new = digest(part)
        target = _unused(path, new, replaceable)
        _list(target, new)
        part.replace(target)
    return target


def is_own(path: Path) -> bool:
    """Whether a file is as the program wrote it."""
    listed = _listed(path.parent).get(path.name, [])
    return path.is_file() and digest(path) in listed


def latest(path: Path) -> Path:
    """The file that was written last for `path`: itself, or one with a number."""
    numbered = re.compile(rf"{re.escape(path.stem)}(-\d+)?{re.escape(path.suffix)}")
    names = [n for n in _listed(path.parent) if numbered.fullmatch(n)]
    candidates = [path.with_name(name) for name in reversed(names)]
    return next((c for c in candidates if c.is_file()), path)


def set_aside(path: Path, word: str) -> Path:
    """Rename a file to a name that is free, with a word, as in `result-earlier.json`."""
    for number in itertools.count(1):
        mark = word if number == 1 else f"{word}-{number}"
        free = path.with_name(f"{path.stem}-{mark}{path.suffix}")
        if not free.exists():
            return path.rename(free)
    raise AssertionError


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _unused(path: Path, new: str, replaceable: Collection[str]) -> Path:
    """The path, or the first one with a number that no file of the user has."""
    listed = _listed(path.parent)
    for number in itertools.count(1):
        name = path.name if number == 1 else f"{path.stem}-{number}{path.suffix}"
        candidate = path.with_name(name)
        if not candidate.is_file():
            return candidate
        if digest(candidate) in (new, *listed.get(name, []), *replaceable):
            return candidate
    raise AssertionError


def _list(path: Path, new: str) -> None:
    """Record a file and what it replaces before it appears, for one killed between."""
    listed = _listed(path.parent)
    earlier = [digest(path)] if path.is_file() else []
    listed.pop(path.name, None)
    listed[path.name] = list(dict.fromkeys([*earlier, new]))
    with whole_file(path.with_name(LIST_NAME)) as part:
        part.write_text(json.dumps(listed, indent=1), encoding="utf-8")


def _listed(folder: Path) -> dict[str, list[str]]:
    """Digests by name; none where the list is missing or broken."""
    file = folder / LIST_NAME
    with contextlib.suppress(OSError, ValueError, TypeError, RecursionError):
        if file.stat().st_size <= MAX_LIST_BYTES:
            plain = json.loads(file.read_text(encoding="utf-8"))
            return {str(name): [str(d) for d in plain[name]] for name in plain}
    return {}


# -- private folders --------------------------------------------------------------------
def make_private(folder: Path) -> bool:
    """Make a folder, and those above it, for this user alone; whether it is private.

    Who can write into a folder above can put another one in its place. False on Windows,
    which has other permissions. Raises OSError where it cannot be made.
    """
    for path in (*reversed(folder.parents), folder):
        if not path.exists():
            path.mkdir(mode=0o700, exist_ok=True)
    return is_private(folder)


def is_private(path: Path) -> bool:
    """Whether only this user can change a file, or its folders. OSError."""
    user = _user()
    if user is None or path.stat().st_uid != user:
        return False
    whole = path.absolute()
    real = whole.resolve()
    return all(map(_is_safe, {whole, *whole.parents, real, *real.parents}))


def _is_safe(path: Path) -> bool:
    """Whether others can neither write there nor point the path elsewhere."""
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode):
        return status.st_uid == ROOT_USER
    if status.st_uid not in (ROOT_USER, _user()):
        return False
    if stat.S_ISDIR(status.st_mode) and status.st_mode & stat.S_ISVTX:
        return True  # as /tmp, where nobody can rename what is another's
    if status.st_mode & stat.S_IWOTH:
        return False
    return not status.st_mode & stat.S_IWGRP or _is_own_group(status.st_gid)


def _user() -> int | None:
    """Number of this user; None on Windows, which has no such thing."""
    number = getattr(os, "getuid", None)
    return None if number is None else int(number())


def _is_own_group(number: int) -> bool:
    """Whether a group has this user alone, as some systems give each of them one."""
    import grp  # Windows has neither
    import pwd

    try:
        group = grp.getgrgid(number)
        user = pwd.getpwuid(_user() or ROOT_USER).pw_name
    except KeyError:
        return False
    return group.gr_name == user and set(group.gr_mem) <= {user}
