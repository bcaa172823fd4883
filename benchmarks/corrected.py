"""Corrected compensation on machines of the oracles: bands and rms, predicted and realised.

    python -m benchmarks.corrected --machines 300

Each machine has geometry of its own, readings with noise, and one to three effects on
all joints (growth by temperature, play, scale). Parameters and effects are estimated
together; the controller takes both, and the oracle says where the machine then stands.
The table has the share of poses inside their predicted 95 % bands, with its standard
error over machines, and the realised over the predicted rms error. The effects
have the textbook's form, and the estimate knows that; with `--free-form` it doubts it.
`--case` limits the table to one machine.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.harness.tables import head, row

TESTS = Path(__file__).parent.parent / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "fixtures")]

from kernel import corrected_cases, corrected_machines  # noqa: E402


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.corrected")
    parser.add_argument("--machines", type=int, default=300)
    parser.add_argument("--case", choices=sorted(corrected_cases.CASES))
    parser.add_argument("--free-form", action="store_true")
    given = parser.parse_args()
    names = [given.case] if given.case else list(corrected_cases.CASES)
    columns = ("inside 95 %", "error", "realised/predicted")
    print(head("machine", "drawn", "component", *columns), flush=True)
    for name in names:
        case = corrected_cases.CASES[name]()
        found = corrected_machines.coverage(
            case, given.machines, 1, free_form=given.free_form
        )
        for k, component in enumerate(found.components):
            inside = (f"{found.inside[k]:.3f}", f"{found.inside_error[k]:.3f}")
            ratio = f"{found.ratio[k]:.3f} ± {found.ratio_error[k]:.3f}"
            print(row(name, given.machines, component, *inside, ratio), flush=True)


if __name__ == "__main__":
    main()
