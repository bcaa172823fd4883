"""C sources of tests, compiled by the compiler of the system and called."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

FLAGS = ("-std=c99", "-O2", "-Wall", "-Werror", "-shared", "-fPIC")


def library(source: Path, *includes: Path) -> ctypes.CDLL:
    """The compiled source; the test skips where there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: this system has no `cc`")
    target = source.with_suffix(".so")
    folders = [f"-I{folder}" for folder in includes]
    call = [compiler, *FLAGS, *folders, str(source), "-o", str(target), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(target))


def pointer(row: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(row.ctypes.data)
