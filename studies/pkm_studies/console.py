"""Prints on any terminal: encodings without σ, closed pipes, one line for an error."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any


def set_up() -> None:
    """Replace characters that the terminal's encoding lacks, as σ in cp1252, by ?."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def print_error(line: str) -> None:
    """Print one line about an error on stderr."""
    print(f"oed: {line}", file=sys.stderr, flush=True)


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
