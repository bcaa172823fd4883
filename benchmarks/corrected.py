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
import time
from pathlib import Path

TESTS = Path(__file__).parent.parent / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "fixtures")]

from kernel import corrected_cases, corrected_machines  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=300)
    parser.add_argument("--case", choices=sorted(corrected_cases.CASES))
    parser.add_argument("--free-form", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    names = [arguments.case] if arguments.case else list(corrected_cases.CASES)
    print("| machine | drawn | component | inside 95 % | error | realised/predicted |")
    print("|---|---|---|---|---|---|")
    for name in names:
        case = corrected_cases.CASES[name]()
        start = time.process_time()
        found = corrected_machines.coverage(
            case, arguments.machines, arguments.seed, free_form=arguments.free_form
        )
        seconds = time.process_time() - start
        for k, component in enumerate(found.components):
            print(
                f"| {name} | {arguments.machines} | {component}"
                f" | {found.inside[k]:.3f} | {found.inside_error[k]:.3f}"
                f" | {found.ratio[k]:.3f} ± {found.ratio_error[k]:.3f} |",
                flush=True,
            )
        print(f"{name}: {seconds:.0f} s of processor time", file=sys.stderr)


if __name__ == "__main__":
    main()
