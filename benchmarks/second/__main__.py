"""Draw a set of cases of the second generator.

    python -m benchmarks.second generate --seed 7 --cases 20
    PYTHONPATH=. oed campaign --allow-code benchmarks/second.campaign.toml --seeds 20
    python -m benchmarks.harness second

draws 20 cases of each machine, diagnoses each under the estimated and the true noise
law, and prints the table.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from benchmarks.second import world


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 done or no generator, 2 bad input."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.second")
    parser.add_argument("command", choices=("generate",))
    out = Path("out/second/set")
    parser.add_argument("--out", type=Path, default=out, help="folder of the set")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=20, help="of each machine")
    options = parser.parse_args(arguments)
    try:
        world.generate(options.out, options.seed, options.cases)
    except FileNotFoundError as missing:
        print(f"skipped: the second generator is not there ({missing})")
    except (OSError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
