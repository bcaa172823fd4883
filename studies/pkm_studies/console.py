"""Prints on any terminal: encodings without σ, closed pipes; exit codes."""

import contextlib
import errno
import io
import os
import sys
from typing import Any

#: exit codes: fine; a claim not met or a fit not to be trusted; what cannot be used
DONE, FAILED, BAD_INPUT = 0, 1, 2
OUTPUT = "standard output"  #: the standard output in messages
#: errors of writing: full disk, quota, largest file, device, closed stream
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)

DEFAULT_COLUMNS = 120  #: columns of a table where there is no terminal


def set_up() -> None:
    """Replace characters that the terminal's encoding lacks, as σ in cp1252, by ?.

    Raises OSError where the standard output is closed. Streams that are closed get the
    null device: otherwise the next file that is opened would have their number.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
        raise OSError(errno.EBADF, "it is closed", OUTPUT)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def terminal() -> Any:
    """The terminal for tables and long lines, WIDTH columns wide where there is none."""
    from rich.console import Console

    return Console(
        width=None if sys.stdout.isatty() else DEFAULT_COLUMNS, highlight=False
    )


def table_lines(table: Any) -> list[str]:
    """A table of the rich package as the lines that the terminal shows."""
    output = terminal()
    with output.capture() as captured:
        output.print(table, markup=False)
    return [line for line in captured.get().splitlines() if line.strip()]


def height(line: str, width: int) -> int:
    """Lines of the terminal that a printed line takes."""
    return max(1, -(-len(line) // width))


def print_error(line: str) -> None:
    """Print one line about an error on stderr, if it can be written."""
    print_on_error_stream(f"oed: {line}")


def print_on_error_stream(text: str) -> None:
    """Print on stderr, if it can be written."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


def is_about_output(error: OSError) -> bool:
    """Whether an error, which names no file, is about the standard output."""
    return error.filename is None and error.errno in DISK_ERRORS


def print_json(value: Any) -> None:
    """Print JSON, with escapes where the terminal's encoding is not Unicode."""
    import json

    unicode = (sys.stdout.encoding or "").lower().startswith("utf")
    print(json.dumps(value, indent=2, ensure_ascii=not unicode))


def reader_has_gone(error: OSError) -> bool:
    """Whether the error says that nobody reads stdout any more (`oed list | head`)."""
    if isinstance(error, BrokenPipeError):
        return True
    # Windows reports a closed pipe as an invalid argument, of no file
    return os.name == "nt" and error.errno == errno.EINVAL and not error.filename


def discard_output() -> None:
    """Send what is still to be written on stdout to nowhere."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # stdout is no file, or is closed
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
