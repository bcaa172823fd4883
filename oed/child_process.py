"""Child processes: all start here, and Python ones import nothing of the current folder.

That folder is the first on the path of `python -m` and of the `python -c` by which workers
are spawned: a file `numpy.py` that lies beside a study would run, unasked.
"""

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent import futures
from pathlib import Path
from typing import Final

#: with any value as the option -P of Python; processes of multiprocessing inherit it
SAFE_PATH: Final = "PYTHONSAFEPATH"
_running: set[subprocess.Popen[bytes]] = set()  #: programs that `run` waits for


def run(
    command: Sequence[str], folder: Path, longest: float
) -> subprocess.CompletedProcess[bytes]:
    """Run another program in a folder for `longest` s at most, without input; its
    output is kept. Raises OSError, subprocess.SubprocessError.
    """
    with subprocess.Popen(
        command,
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as program:
        _running.add(program)
        try:
            output, errors = program.communicate(timeout=longest)
        except BaseException:
            program.kill()
            raise
        finally:
            _running.discard(program)
    return subprocess.CompletedProcess(command, program.returncode, output, errors)


def end_programs() -> None:
    """End what `run` waits for in other threads."""
    for program in list(_running):
        program.terminate()


def start_python(module: str, arguments: Sequence[str | Path]) -> subprocess.Popen[str]:
    """Start a module of this Python, as `python -m` does, with pipes for its output."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", module, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
    )


def worker(initializer: Callable[[], None]) -> futures.ProcessPoolExecutor:
    """A process for functions of this one, spawned as on every system."""
    context = multiprocessing.get_context("spawn")
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        pool = futures.ProcessPoolExecutor(1, context, initializer)
        pool.submit(int)  # the process starts with its first task
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before
    return pool
