"""Pages of the API reference, one a package: a table of its modules, then each module.

The pages are written before Sphinx reads its sources, into `reference/api`, from the
packages' files. So a module that moves is found where it is.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import plain_docstrings
from sphinx.application import Sphinx

FOLDER = Path("reference", "api")
#: where each package lies, and whether its pages hold all functions and classes
PACKAGES = {
    "oed": (".", True),
    "pkm_models": ("models", True),
    "pkm_reports": ("reports", False),
    "pkm_studies": ("studies", False),
    "pkm_campaign": ("studies", False),
    "pkm_page": ("studies", False),
    "pkm_printers": ("studies", False),
    "pkm_certificate": ("studies", False),
}


class Module(NamedTuple):
    """A module or a package: its full name, its file, the first sentence about it."""

    name: str
    path: Path
    summary: str

    @property
    def is_package(self) -> bool:
        """Whether other modules are in it."""
        return self.path.name == "__init__.py"


def module(name: str, path: Path) -> Module:
    """The module of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    text = ast.get_docstring(tree) or ""
    return Module(name, path, " ".join(text.partition("\n\n")[0].split()))


def below(package: Module) -> Iterator[Module]:
    """Public modules and packages right below a package, by name."""
    for path in sorted(package.path.parent.iterdir()):
        file = path / "__init__.py" if path.is_dir() else path
        if file.suffix == ".py" and not path.name.startswith("_") and file.exists():
            yield module(f"{package.name}.{path.stem}", file)


def exported(package: Module) -> list[str]:
    """Names that a package offers in `__all__`."""
    names = getattr(importlib.import_module(package.name), "__all__", [])
    return [name for name in names if not name.startswith("_")]


def table(modules: list[Module]) -> list[str]:
    """Modules with what each computes."""
    lines = [".. rst-class:: fields modules", ""]
    for entry in modules:
        lines.append(f":py:mod:`{entry.name.rpartition('.')[2]} <{entry.name}>`")
        lines.append(f"    {plain_docstrings.inline(entry.summary)}")
    return [*lines, ""] if modules else []


def page(package: Module, *, full: bool) -> str:
    """reStructuredText of a package's page."""
    entries = list(below(package))
    modules = [m for m in entries if not m.is_package]
    folders = [m for m in entries if m.is_package]
    names = exported(package) if "." not in package.name else []
    lines = [f"``{package.name}``", "=" * (len(package.name) + 4), ""]
    lines += [f".. automodule:: {package.name}"]
    if full and names:
        lines += [f"   :members: {', '.join(names)}", "   :imported-members:"]
    lines += ["", *table(folders), *table(modules)]
    for entry in modules:
        heading = entry.name.rpartition(".")[2]
        lines += [heading, "-" * len(heading), "", f".. automodule:: {entry.name}"]
        lines += ["   :members:", ""] if full else [""]
    if folders:
        lines += [".. toctree::", "   :hidden:", ""]
        lines += [*[f"   {m.name}" for m in folders], ""]
    return "\n".join(lines)


def write(folder: Path, package: Module, *, full: bool) -> set[Path]:
    """Write the pages of a package and of all below it; unchanged ones keep their time."""
    path = folder / f"{package.name}.rst"
    text = page(package, full=full)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
    written = {path}
    for entry in below(package):
        if entry.is_package:
            written |= write(folder, entry, full=full)
    return written


def generate(app: Sphinx) -> None:
    """Write all pages, and remove those of packages that are no more."""
    source = Path(app.srcdir)
    folder = source / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    written: set[Path] = set()
    for name, (place, full) in PACKAGES.items():
        path = source.parent / place / name / "__init__.py"
        written |= write(folder, module(name, path), full=full)
    for path in set(folder.glob("*.rst")) - written:
        path.unlink()


def setup(app: Sphinx) -> dict[str, Any]:
    """Generate before the sources are read."""
    app.connect("builder-inited", generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
