"""What starting costs: processor time of commands beside that of what they import.

    python -m benchmarks.start

Of each command the least user and system time of some rounds, taken in turn with the
import of the libraries that it cannot do without, and which of the heavy libraries it
has loaded when it ends. One BLAS thread, files compiled before the clock runs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

from benchmarks.harness.tables import head, row

ROUNDS = 4  #: rounds, of which the first compiles
#: arguments of each command, and what it cannot do without
JOBS = {
    "--help": ((), "sys"),
    "check": (("a3_ball_bar",), "casadi, numpy, pandas"),
    "run": (("a3_ball_bar",), "casadi, numpy, pandas, scipy, matplotlib.figure"),
}
#: libraries that take a tenth of a second or more to import, or that load such
COMMAND = """
import sys
from pkm_studies.commands.cli import main
try:
    main()
except SystemExit:
    pass
heavy = "casadi", "numpy", "pandas", "scipy", "matplotlib", "arviz_stats", "typst"
print("loaded:", *[name for name in heavy if name in sys.modules])
"""


def run(code: str, *arguments: str) -> tuple[float, str]:
    """Processor time, s, of a script, and the last line that it prints."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command, before = [sys.executable, "-c", code, *arguments], os.times()
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    after = os.times()
    seconds = after.children_user - before.children_user
    seconds += after.children_system - before.children_system
    return seconds, done.stdout.rpartition("loaded:")[2].strip()


def main() -> None:
    """Print a table."""
    print(head("command", "s", "its libraries alone, s", "loaded"))
    for name, (arguments, needed) in JOBS.items():
        code = f"import {needed}"
        rounds = [
            (*run(COMMAND, name, *arguments), run(code)[0]) for _ in range(ROUNDS)
        ]
        ours, loaded, floor = zip(*rounds[1:], strict=True)
        print(row(f"oed {name}", f"{min(ours):.2f}", f"{min(floor):.2f}", loaded[0]))


if __name__ == "__main__":
    main()
