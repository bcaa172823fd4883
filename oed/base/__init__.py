"""What knows no machine: arrays, orientations, smooth bases, and how rooms hand out names.

door           a room's `__getattr__` for the names that it hands out
Array          an array of numbers
Index          an array of indices
Mask           an array of truth values
consecutive_slices  slices of some sizes, one after the other
grid_nodes     the nodes of a rectilinear grid
Orientation    three angles of a platform, by their order
curve_mode     a mode of a smooth curve over a span
field_modes    the modes of a smooth field at places
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oed.base.arrays import Array, Index, Mask, consecutive_slices, grid_nodes
    from oed.base.orientation import Orientation
    from oed.base.smooth_basis import curve_mode, field_modes


def door(package: str) -> Callable[[str], Any]:
    """A package's `__getattr__` for the names that it imports under TYPE_CHECKING.

    So each name stands once in the package's file, where type checkers and the linter
    of imports read it as well.
    """
    where: dict[str, str] = {}

    def get(name: str) -> Any:
        if name.startswith("__"):  # asked for by Python itself
            raise AttributeError(name)
        if not where:
            where.update(_names(package))
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(where[name]), name)

    return get


def _names(package: str) -> Iterator[tuple[str, str]]:
    """The names of a package's door, each with the module that defines it."""
    source = Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((alias.name, node.module) for alias in node.names)


if not TYPE_CHECKING:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
