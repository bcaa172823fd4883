"""Runs Python files that a study or a command names, once the user allowed them.

Data never runs code by itself. A file runs where the user said so (`--allow-code`),
where he said so before and the file is unchanged, or where the study and the file lie
in folders that he trusts. It lies in the folder of the study that names it, or below.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import hashlib
import os
import sys
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from types import ModuleType

import platformdirs

from oed.safe_files import is_private, make_private
from oed.text import shorten
from pkm_studies import files
from pkm_studies.base import InputError, Location

SUFFIX = ".py"
MAX_BYTES = 4_000_000  #: bytes of the largest file that is run
MAX_REASON_LENGTH = 120  #: characters of an error that are shown


class Consent(enum.Enum):
    """Whether the Python files that a reference names may run.

    NEVER     no: it stands in a stored result
    RECORDED  those that the user allowed before, and those in folders he trusts
    GIVEN     yes: the user says so with this call, which is remembered
    """

    NEVER = enum.auto()
    RECORDED = enum.auto()
    GIVEN = enum.auto()

    @staticmethod
    def from_call(*, allow_code: bool) -> Consent:
        """The consent of a call with `--allow-code`, or without."""
        return Consent.GIVEN if allow_code else Consent.RECORDED


@dataclasses.dataclass(frozen=True, slots=True)
class Origin:
    """Where a reference stands."""

    folder: Path = Path()  #: that its paths are relative to
    consent: Consent = Consent.RECORDED  #: to run the files that it names
    typed: bool = False  #: whether the user typed it: then the file may lie anywhere

    @classmethod
    def command(cls, consent: Consent) -> Origin:
        """Of a reference that the user typed as an argument of a command."""
        return cls(Path(), consent, typed=True)


def is_file(reference: str) -> bool:
    """Whether a reference names a Python file: `mine.py` or `mine.py:attribute`."""
    return file_name(reference).endswith(SUFFIX)


def file_name(reference: str) -> str:
    """What stands before the attribute; a drive of Windows has a colon as well."""
    if reference.endswith(SUFFIX):
        return reference
    return reference.rpartition(":")[0]


def run_file(name: str, origin: Origin, location: Location) -> ModuleType:
    """The module of a Python file, run once a process if it may. Raises InputError."""
    path = _permitted_path(name, origin, location)
    source = _source(path, location)
    digest = hashlib.sha256(source).hexdigest()
    _check_consent(path, digest, origin, location)
    # a name of its own, so that two files called machine.py do not meet
    where = hashlib.sha256(str(path.resolve()).encode()).hexdigest()
    module_name = f"pkm_user_{path.stem}_{where[:8]}_{digest[:8]}"
    if module_name in sys.modules:
        return sys.modules[module_name]
    module = ModuleType(module_name)
    module.__file__ = str(path)
    sys.modules[module_name] = module
    try:
        # The bytes of the digest: neither a cached .pyc nor a file changed since.
        exec(compile(source, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[module_name]
        raise _failure(error, name, location) from error
    except BaseException:
        del sys.modules[module_name]
        raise
    return module


def _permitted_path(name: str, origin: Origin, location: Location) -> Path:
    """The path of a file that lies where files may run."""
    if origin.consent is Consent.NEVER:
        raise location.error(
            "a stored result runs no Python file", "give the study: --study STUDY", name
        )
    path = origin.folder / name
    if origin.typed:
        return path
    absolute = PurePosixPath(name).is_absolute() or PureWindowsPath(name).anchor
    inside = path.resolve().is_relative_to(origin.folder.resolve())
    # a file that both ends of a shared folder trust may lie beside the study's folder
    if absolute or not (inside or is_trusted(origin.folder, path)):
        raise location.error(
            "this file does not lie in the folder of the study that names it",
            "put it there and name it from there; a study runs no other Python file",
            name,
        )
    return path


def _source(path: Path, location: Location) -> bytes:
    if not path.is_file():
        raise location.error(
            "there is no such file", "paths are relative to the study file", str(path)
        )
    size = path.stat().st_size
    if size > MAX_BYTES:
        problem = f"{size / 1e6:.1f} MB are too many for a Python file"
        raise location.error(problem, "check that this is the right file", str(path))
    return path.read_bytes()


def _check_consent(path: Path, digest: str, origin: Origin, location: Location) -> None:
    if origin.consent is Consent.GIVEN:
        allow(path, digest)
        return
    if is_allowed(digest):
        return
    folder = path.parent if origin.typed else origin.folder
    if is_trusted(folder, path):
        return
    raise location.error(
        f"Python code runs once you allow it: SHA-256 {digest} of {path.name}",
        "read the file; then add --allow-code to the command (allow_code=True in"
        f" Python), or trust its folder: {FIELD} in"
        f" {settings_file()}",
        str(path),
    )


def _failure(error: BaseException, name: str, location: Location) -> InputError:
    """What the file raised, as bad input."""
    if isinstance(error, InputError):
        return error
    moved = str(getattr(error, "name", "")).startswith(("oed.", "pkm_models."))
    if isinstance(error, ModuleNotFoundError) and moved:
        return location.error(
            f"it imports {error.name}, which is not there in this version",
            "import names such as Machine, Parameter, Instrument and Effect from oed"
            " itself: from oed import Machine; what machines share is in"
            " pkm_models.machines.parts",
            name,
        )
    if isinstance(error, ModuleNotFoundError):
        return location.error(
            f"it imports the module {error.name}, which was not found",
            "install it, or put it on PYTHONPATH",
            name,
        )
    return location.error(
        f"importing it failed with {type(error).__name__}:"
        f" {shorten(str(error), MAX_REASON_LENGTH)}",
        "mend the file, or run it alone with Python to see where",
        name,
    )


# Which Python files of other people's studies the user allows to run.
#
# Two things allow a file. Its digest stands in the list of files that were allowed
# before, in the user's state folder. Or it lies in a folder that the user trusts: in his
# settings, or in the environment variable `OED_TRUSTED_FOLDERS`.

APP = "pkm-oed"
VARIABLE = "OED_TRUSTED_FOLDERS"  #: trusted folders, separated as in PATH
FIELD = "trusted_folders"  #: field of the settings with the trusted folders
#: bytes of the largest file of settings, and of the list of allowed files
SETTINGS_LIMIT = 1_000_000


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
    """Whether each path lies in a trusted folder. Raises InputError for bad settings."""
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
        table = tomllib.loads(
            files.read_text(file, limit=SETTINGS_LIMIT, what="settings file")
        )
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
