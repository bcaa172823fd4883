"""A room hands out few names, by its `__init__`, with a sentence each."""

import ast
import importlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAX_NAMES = 15
#: rooms that hand out more, and how many: the figure falls, and never grows
LARGER = {
    "oed.dataset": 30, "oed.gap": 24, "pkm_studies.resolve": 24,
    "pkm_studies.stages": 31,
}  # fmt: skip
#: tables of a study file and records of a result are as many as the files have
RECORDS = {"oed.result.*", "pkm_studies.tables.*"}


def _doors() -> Iterator[tuple[str, Path]]:
    """The rooms that hand out names, and the file of each that does."""
    for top in ("oed", "models", "studies", "reports"):
        base = ROOT if top == "oed" else ROOT / top
        for file in sorted((ROOT / top).rglob("__init__.py")):
            room = ".".join(file.parent.relative_to(base).parts)
            if f"{room}.*" in PROTECTED:
                yield room, file


def _protected() -> set[str]:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    held = [c["protected_modules"] for c in contracts if c["type"] == "protected"]
    return {module for modules in held for module in modules} - RECORDS


def _handed_out(tree: ast.Module) -> set[str]:
    """Names that are imported for type checkers, and functions of the file itself."""
    checked = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in checked.body if isinstance(node, ast.ImportFrom)]
    names = {alias.name for node in imports for alias in node.names}
    functions = {n.name for n in tree.body if isinstance(n, ast.FunctionDef)}
    return names | {name for name in functions if not name.startswith("_")}


PROTECTED = _protected()
DOORS = dict(_doors())


@pytest.mark.parametrize("room", DOORS)
def test_each_name_of_a_door_has_a_sentence(room):
    file = DOORS[room]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = _handed_out(tree)
    assert 1 <= len(names) <= LARGER.get(room, MAX_NAMES)
    lines = (ast.get_docstring(tree) or "").splitlines()
    assert names == {line.split()[0] for line in lines[2:] if line[:1].strip()}
    door = importlib.import_module(room)
    for name in names:
        assert getattr(door, name) is not None
        # a module of that name would hide it once it is imported
        assert not (file.parent / f"{name}.py").exists()
        assert not (file.parent / name).is_dir()
    assert (file.parent / "README.md").is_file()


def _readmes() -> list[Path]:
    tops = ("oed", "models", "studies", "reports")
    return sorted(file for top in tops for file in (ROOT / top).rglob("README.md"))


@pytest.mark.parametrize("readme", _readmes(), ids=lambda file: file.parent.name)
def test_a_readme_names_modules_that_exist(readme):
    text = readme.read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py)`", text)
    folders = (readme.parent, ROOT, ROOT / "studies")
    known = [n for n in named if any((folder / n).is_file() for folder in folders)]
    assert known == named
