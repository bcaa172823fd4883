"""Finds the studies that come with the package, by name."""

import dataclasses
import re
import tomllib
from importlib import resources
from pathlib import Path

from oed.text import suggest
from pkm_studies import files
from pkm_studies.base import InputError, Location, check_name
from pkm_studies.study import SUFFIX

NAME_LINE = re.compile(r'^name = ".*"$', re.MULTILINE)


@dataclasses.dataclass(frozen=True, slots=True)
class ShippedStudy:
    """A study of the package: its name, title, question and file."""

    name: str
    title: str
    question: str
    path: Path


def folder() -> Path:
    """The folder of the shipped studies, in the wheel or in the repository."""
    package = Path(str(resources.files("pkm_studies")))
    installed = package / "shipped"
    return installed if installed.is_dir() else package.parent


def studies() -> dict[str, ShippedStudy]:
    """The shipped studies, by name."""
    listing = {}
    for path in sorted(folder().glob(f"*{SUFFIX}")):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        name = path.name.removesuffix(SUFFIX)
        title, question = table.get("title", name), table.get("question", "")
        listing[name] = ShippedStudy(name, title, question, path)
    return listing


def find(name: str, field: str) -> Path:
    """The file of the shipped study of this name. Raises InputError about `field`."""
    available = {p.name.removesuffix(SUFFIX): p for p in folder().glob(f"*{SUFFIX}")}
    if name not in available:
        remedy = suggest(name, available, "shipped")
        raise InputError("no such shipped study", remedy, field=field, value=name)
    return available[name]


def study_path(path: Path) -> Path:
    """The file of a study that a command names: a path, or a shipped study's name.

    A file that exists goes first, and a shipped study before a folder of its name: that
    may hold its results. Raises InputError for a name without a suffix that is neither.
    """
    is_name = path.name == str(path) and not path.suffix
    is_shipped = is_name and (folder() / f"{path}{SUFFIX}").is_file()
    if not is_name or path.is_file() or (path.exists() and not is_shipped):
        return path
    return find(path.name, "STUDY")


def copy(name: str, source: str, out: Path) -> Path:
    """Write a shipped study under a new name; its path. Raises InputError."""
    text = find(source, "--from").read_text(encoding="utf-8")
    path = new_path(name, out)
    title = path.name.removesuffix(SUFFIX)
    return files.write_whole(path, NAME_LINE.sub(f'name = "{title}"', text, count=1))


def new_path(name: str, out: Path) -> Path:
    """The file of a new study. Raises InputError for a bad name or an existing file."""
    name = name.removesuffix(SUFFIX)
    check_name(name, Location("", "NAME"))
    path = out / f"{name}{SUFFIX}"
    if path.exists():
        problem = "there is a study of this name"
        raise InputError(problem, "choose another name, or remove it", file=str(path))
    return path
