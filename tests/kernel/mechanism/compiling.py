"""Functions that are compiled in a folder of the tests, and their array code."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from oed.mechanism.compiled import compiler
from oed.mechanism.compiled.switch import AT_ONCE, NEVER, VARIABLE

Result = TypeVar("Result")

needs_compiler = pytest.mark.skipif(
    not any(shutil.which(name) for name in compiler.COMPILERS),
    reason="no C compiler on this system",
)


@pytest.fixture(scope="session")
def compiled_files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of compiled files, of these tests alone."""
    folder = tmp_path_factory.mktemp("cache") / "compiled"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "cache_folder", lambda: folder)
        yield folder


def compiled(build: Callable[[], Result]) -> Result:
    """What is built with functions that are compiled at once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, AT_ONCE)
        return build()


def array_code(build: Callable[[], Result]) -> Result:
    """The same with functions that are never compiled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, NEVER)
        return build()
