"""The exit code of a benchmark's command."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence

BAD_INPUT = 2


def exit_code(
    parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None
) -> int:
    """What the chosen `run` of the options returns; 2, with a line, for bad input."""
    options = parser.parse_args(arguments)
    try:
        return int(options.run(options))
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return BAD_INPUT
