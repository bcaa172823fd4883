"""Names of a package that are imported from its modules when first used (PEP 562)."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def attributes(
    package: str, modules: Mapping[str, Sequence[str]]
) -> Callable[[str], Any]:
    """A package's `__getattr__` for {module: names that it defines}."""
    where = {name: module for module, names in modules.items() for name in names}

    def get(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = importlib.import_module(f"{package}.{where[name]}")
        return getattr(module, name)

    return get
