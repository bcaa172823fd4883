"""What starting costs: processor time of commands beside that of what they import.

    python benchmarks/start.py [--rounds 3]

Of each command the least user and system time of some rounds, taken in turn with the
import of the libraries that it cannot do without, and which of the heavy libraries it
has loaded when it ends. One BLAS thread, files compiled before the clock runs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile

#: libraries that take a tenth of a second or more to import, or that load such
HEAVY = ("casadi", "numpy", "pandas", "scipy", "matplotlib", "arviz_stats", "typst")
#: arguments of each command, and what it cannot do without
JOBS = {
    "--help": ((), "sys"),
    "check": (("a3_ball_bar",), "casadi, numpy, pandas"),
    "run": (("a3_ball_bar",), "casadi, numpy, pandas, scipy, matplotlib.figure"),
}
COMMAND = """
import sys
from pkm_studies.commands.cli import main
try:
    main()
except SystemExit:
    pass
print("loaded", *[name for name in {heavy} if name in sys.modules])
"""


def run(code: str, arguments: tuple[str, ...], folder: str) -> tuple[float, str]:
    """Processor time, s, of a script, and the last line that it prints."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = os.times()
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    after = os.times()
    seconds = after.children_user - before.children_user
    seconds += after.children_system - before.children_system
    return seconds, done.stdout.strip().rpartition("\n")[2]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    code = COMMAND.format(heavy=HEAVY)
    print(
        "| command | s | its libraries alone, s | loaded |\n| --- | --: | --: | --- |"
    )
    for name, (arguments, needed) in JOBS.items():
        ours, floor, loaded = [], [], ""
        for _ in range(rounds + 1):
            with tempfile.TemporaryDirectory() as folder:
                seconds, loaded = run(code, (name, *arguments), folder)
                ours.append(seconds)
                floor.append(run(f"import {needed}", (), folder)[0])
        # the first round compiles
        least = f"{min(ours[1:]):.2f} | {min(floor[1:]):.2f}"
        print(
            f"| oed {name} | {least} | {loaded.removeprefix('loaded ')} |", flush=True
        )


if __name__ == "__main__":
    main()
