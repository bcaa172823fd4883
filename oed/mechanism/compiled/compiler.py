"""The C compiler of this computer, and the files that it made, kept from run to run.

A text is compiled once a computer. The file's name is a digest of text, flags, compiler
and processor, and one of its content: so a changed compiler compiles anew, and a damaged
file is not loaded. Whatever fails, there is no function, and the array code serves.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import platformdirs

from oed import child_process
from oed.safe_files import make_private, whole_file

#: names of compilers that know the vectors of lanes.h
COMPILERS = ("cc", "gcc", "clang")
#: `-fno-math-errno` and `-fno-trapping-math` change no result; a product and a sum may
#: become one operation, rounded once
FLAGS = (
    *("-std=gnu11", "-O2", "-fno-math-errno", "-fno-trapping-math"),
    *("-ffp-contract=fast", "-fno-strict-aliasing", "-w", "-shared", "-fPIC"),
)
#: all that this processor can do, or what every one can, where the compiler cannot tell
PROCESSORS = (("-march=native",), ())
#: longest time of a compilation, s
COMPILATION_TIMEOUT = 120.0
#: files of the folder beyond which the oldest are removed
MAX_FILES = 512
#: characters of a digest in a file's name
DIGEST_LENGTH = 32
#: name of the folder with the compiled files
FOLDER_NAME = "compiled"


@dataclasses.dataclass(frozen=True)
class Compiler:
    """A compiler of this computer.

    path      its program
    identity  what changes with the compiler and the processor
    """

    path: str
    identity: str


def load(text: str) -> ctypes.CDLL | None:
    """The functions of a C text; None where they cannot be compiled or loaded."""
    compiler = find_compiler(os.environ.get("PATH", ""))
    return None if compiler is None else _load(text, compiler, cache_folder())


def cache_folder() -> Path:
    """The folder of the compiled files, of this user and computer."""
    return platformdirs.user_cache_path("pkm-oed", appauthor=False) / FOLDER_NAME


@functools.cache
def find_compiler(search_path: str) -> Compiler | None:
    """The first compiler on the search path; None on Windows, or where there is none.

    Relative folders of the path are passed over: they would be anybody's. GCC on Windows
    does not align vectors on the stack.
    """
    if os.name != "posix":
        return None
    folders = os.pathsep.join(filter(os.path.isabs, search_path.split(os.pathsep)))
    for name in COMPILERS:
        program = shutil.which(name, path=folders)
        if program is not None and not _asks_to_install(program):
            file = Path(program).resolve()
            with contextlib.suppress(OSError):
                status = file.stat()
                marks = (file, status.st_size, status.st_mtime_ns, _processor())
                return Compiler(program, "\n".join(map(str, marks)))
    return None


def _asks_to_install(program: str) -> bool:
    """Whether a program opens a window in place of compiling: on a Mac without tools."""
    if sys.platform != "darwin" or not program.startswith("/usr/bin/"):
        return False
    asked = child_process.run(
        ["/usr/bin/xcode-select", "-p"], Path("/"), COMPILATION_TIMEOUT
    )
    return asked.returncode != 0


def _processor() -> str:
    """What distinguishes this processor from others: its model and abilities."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            first = file.read(16384).split("\n\n", 1)[0]
    except OSError:
        return f"{platform.machine()} {platform.processor()} {platform.version()}"
    kinds = ("vendor_id", "cpu family", "model", "flags", "CPU ", "Features")
    return "\n".join(line for line in first.splitlines() if line.startswith(kinds))


@functools.cache
def _load(text: str, compiler: Compiler, folder: Path) -> ctypes.CDLL | None:
    """As `load`, once a process for each text."""
    parts = "\n".join([text, *FLAGS, str(PROCESSORS), compiler.identity])
    digest = hashlib.sha256(parts.encode()).hexdigest()[:DIGEST_LENGTH]
    try:
        if not make_private(folder):
            return None
        for file in sorted(folder.glob(f"{digest}-*.so")):
            if _is_whole(file):
                return ctypes.CDLL(str(file))
            file.unlink(missing_ok=True)
        return _opened(_compile(text, compiler, folder, digest))
    except (OSError, subprocess.SubprocessError):
        return None


def _opened(file: Path) -> ctypes.CDLL:
    """A new file's functions. Raises OSError, without the file, where it has none."""
    try:
        return ctypes.CDLL(str(file))
    except OSError:
        file.unlink(missing_ok=True)
        raise


def _is_whole(file: Path) -> bool:
    """Whether a file has the content that its name states."""
    return file.stem.partition("-")[2] == _content_digest(file.read_bytes())


def _content_digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:DIGEST_LENGTH]


def _compile(text: str, compiler: Compiler, folder: Path, digest: str) -> Path:
    """The file of a text. Raises OSError, subprocess.SubprocessError."""
    with tempfile.TemporaryDirectory(prefix="pkm-oed-") as scratch:
        source, library = Path(scratch, "lanes.c"), Path(scratch, "lanes.so")
        source.write_text(text, encoding="utf-8")
        files = ("-o", str(library), str(source), "-lm")
        for processor in PROCESSORS:
            command = [compiler.path, *FLAGS, *processor, *files]
            done = child_process.run(command, Path(scratch), COMPILATION_TIMEOUT)
            if done.returncode == 0:
                break
        content = library.read_bytes()
    file = folder / f"{digest}-{_content_digest(content)}.so"
    with whole_file(file) as part:
        part.write_bytes(content)
    _remove_oldest(folder)
    return file


def _remove_oldest(folder: Path) -> None:
    """Keep the folder small: processes that have a file open keep it."""
    files = sorted(folder.glob("*.so"), key=lambda file: file.stat().st_mtime_ns)
    for file in files[:-MAX_FILES]:
        file.unlink(missing_ok=True)
