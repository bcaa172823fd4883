"""Files that the program wrote into a folder: these alone are replaced, while unchanged.

A hidden list in the folder has their digests. A file that the user changed stays, and
the new one gets a number, as in `report-2.html`; so does a file that nobody listed.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import re
from collections.abc import Collection
from pathlib import Path
from typing import Final

from oed.base.whole_file import flush, temporary_file, whole_file

#: the list: SHA-256 of the last contents by name, the file written last at the end
LIST: Final = ".oed-files.json"
#: bytes of the largest list that is read
LIMIT: Final = 4_000_000


def write_own(path: Path, content: bytes, known: Collection[str] = ()) -> Path:
    """Write a file whole, and return its path: `path`, or one with a number.

    known  further digests of files that may be replaced

    Raises OSError.
    """
    with temporary_file(path) as part:
        part.write_bytes(content)
        flush(part)
        new = digest(part)
        target = _unused(path, new, known)
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


def _unused(path: Path, new: str, known: Collection[str]) -> Path:
    """The path, or the first one with a number that no file of the user has."""
    listed = _listed(path.parent)
    for number in itertools.count(1):
        name = path.name if number == 1 else f"{path.stem}-{number}{path.suffix}"
        candidate = path.with_name(name)
        if not candidate.is_file():
            return candidate
        if digest(candidate) in (new, *listed.get(name, []), *known):
            return candidate
    raise AssertionError


def _list(path: Path, new: str) -> None:
    """Record a file before it appears, with the one that it replaces.

    So that a process which is killed between leaves no file that counts as the user's.
    """
    listed = _listed(path.parent)
    earlier = [digest(path)] if path.is_file() else []
    listed.pop(path.name, None)
    listed[path.name] = list(dict.fromkeys([*earlier, new]))
    with whole_file(path.with_name(LIST)) as part:
        part.write_text(json.dumps(listed, indent=1), encoding="utf-8")


def _listed(folder: Path) -> dict[str, list[str]]:
    """Digests by name; none where the list is missing or broken."""
    file = folder / LIST
    with contextlib.suppress(OSError, ValueError, TypeError, RecursionError):
        if file.stat().st_size <= LIMIT:
            plain = json.loads(file.read_text(encoding="utf-8"))
            return {str(name): [str(d) for d in plain[name]] for name in plain}
    return {}
