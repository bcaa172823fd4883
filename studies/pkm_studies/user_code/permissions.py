"""Which Python files of other people's studies the user allows to run.

Two things allow a file. Its digest stands in the list of files that were allowed
before, in the user's state folder. Or it lies in a folder that the user trusts: in his
settings, or in the environment variable `OED_TRUSTED_FOLDERS`.
"""

from __future__ import annotations

import contextlib
import os
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

import platformdirs

from oed.safe_files import is_private, make_private
from oed.text import shorten
from pkm_studies import files
from pkm_studies.base import Location

APP = "pkm-oed"
#: trusted folders, separated as in PATH
VARIABLE = "OED_TRUSTED_FOLDERS"
#: field of the settings with the trusted folders
FIELD = "trusted_folders"
#: bytes of the largest file of settings, and of the list of allowed files
LIMIT = 1_000_000


def settings_file() -> Path:
    """The user's settings."""
    return platformdirs.user_config_path(APP, appauthor=False) / "config.toml"


def allowed_file() -> Path:
    """The list of allowed files: a digest and a path a line, as `sha256sum` writes."""
    return platformdirs.user_state_path(APP, appauthor=False) / "allowed-code.txt"


def is_allowed(digest: str) -> bool:
    """Whether the user allowed a file of this SHA-256 before."""
    return digest in _allowed_digests()


def allow(path: Path, digest: str) -> None:
    """Record that the user allows this file as it is.

    Where the list cannot be written, the permission ends with this process.
    """
    if is_allowed(digest):
        return
    file = allowed_file()
    with contextlib.suppress(OSError):
        make_private(file.parent)
        file.touch(mode=0o600)
        with file.open("a", encoding="utf-8") as lines:
            lines.write(f"{digest}  {shorten(str(path.resolve()), 400)}\n")


def is_trusted(*paths: Path) -> bool:
    """Whether each path lies in some folder that the user trusts.

    Raises InputError for settings that cannot be read.
    """
    folders = list(trusted_folders())
    return all(_lies_in(path, folders) for path in paths)


def trusted_folders() -> Iterator[Path]:
    """The folders of the environment variable, then those of the settings.

    Raises InputError for settings that cannot be read, and for relative folders: these
    would follow the user to every folder he works in.
    """
    listed = os.environ.get(VARIABLE, "").split(os.pathsep)
    yield from _absolute([name for name in listed if name], Location(VARIABLE))
    file = settings_file()
    if not file.is_file():
        return
    location = Location(str(file))
    if not _is_own(file):
        problem = "other users can change this file, or the path to it"
        raise location.error(
            problem, "take their permission to write away, or remove it"
        )
    try:
        table = tomllib.loads(files.read_text(file, limit=LIMIT, what="settings file"))
    except (ValueError, RecursionError) as error:
        problem = f"this is no TOML: {shorten(str(error), 100)}"
        raise location.error(problem, "mend it there, or remove the file") from None
    names = table.get(FIELD, [])
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        remedy = f'write {FIELD} = ["/path/of/a/folder"]'
        raise location.key(FIELD).error("a list of folders is wanted", remedy, names)
    yield from _absolute(names, location.key(FIELD))


def _is_own(file: Path) -> bool:
    """Whether what a file allows comes from this user; Windows itself sees to that."""
    return os.name != "posix" or is_private(file)


def _absolute(names: Iterable[str], location: Location) -> Iterator[Path]:
    for name in names:
        folder = Path(name).expanduser()
        if not folder.is_absolute():
            raise location.error("this folder is relative", "give its whole path", name)
        yield folder.resolve()


def _lies_in(path: Path, folders: Iterable[Path]) -> bool:
    resolved = path.resolve()
    return any(resolved.is_relative_to(folder) for folder in folders)


def _allowed_digests() -> set[str]:
    file = allowed_file()
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
        if not _is_own(file):
            return set()
    except OSError:
        return set()
    return {line.split(maxsplit=1)[0] for line in text.splitlines() if line.strip()}
