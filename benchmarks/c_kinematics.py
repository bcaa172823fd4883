"""Microseconds a call of the generated C kinematics, machine by machine.

    python -m benchmarks.c_kinematics [MACHINE ...]

Each machine has nominal parameters. The C compiler of the system (`cc -O2`) builds the
text of `oed compensate --to c` with a loop over random commands inside the workspace, on
one core. Forward calls start from a pose that is off by 1 mm and 1 mrad.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from oed.base import Array
from oed.mechanism import AssemblyError, Kinematics
from pkm_studies.catalogue import Compensation, Identified
from pkm_studies.compensation.formats import c_code

COMMANDS, CALLS = 200, 20_000
MACHINES = ("delta", "hexapod", "hexaglide", "a3_head", "prs_spindle", "cables_spatial")
LOOP = """
#include <stdio.h>
#include <time.h>

static double seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }

int main(void) {
  static const double commands[][PKM_C] = {@ROWS@};
  static double poses[@N@][PKM_X], joints[@N@][PKM_Q];
  int failed = 0;
  double first = seconds();
  for (int k = 0; k < @CALLS@; k++) {
    int row = k % @N@;
    failed += pkm_inverse(commands[row], NULL, poses[row], joints[row]) != PKM_OK;
  }
  double second = seconds();
  for (int k = 0; k < @CALLS@; k++) {
    int row = k % @N@;
    double pose[PKM_X], command[PKM_C];
    for (int i = 0; i < PKM_X; i++) pose[i] = poses[row][i] + 1e-3;
    for (int i = 0; i < PKM_C; i++) command[i] = commands[row][i] + 1e-3;
    failed += pkm_forward(joints[row], NULL, pose, command) != PKM_OK;
  }
  double third = seconds();
  printf("%g %g %d\\n", (second - first) / @CALLS@, (third - second) / @CALLS@, failed);
  return 0;
}
"""


def measure(name: str, folder: Path) -> tuple[float, float, int]:
    """Microseconds of an inverse and a forward call, and how many failed."""
    machine = importlib.import_module(f"pkm_models.machines.{name}").machine
    kinematics, p = Kinematics(machine), machine.nominal
    command = reachable(kinematics)
    content = Compensation(
        study=name,
        version="0",
        machine=machine,
        kinematics=kinematics,
        identified=Identified(p, 0.0 * p, "nominal"),
        command=command,
        poses=(),
        notes=(),
    )
    rows = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in command.tolist())
    loop = LOOP.replace("@ROWS@", rows).replace("@CALLS@", str(CALLS))
    source = folder / f"{name}.c"
    text = c_code.write(content)[".c"] + loop.replace("@N@", str(len(command)))
    source.write_text(text, "utf-8")
    program = source.with_suffix("")
    subprocess.run(["cc", "-O2", str(source), "-o", str(program), "-lm"], check=True)
    done = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    inverse, forward, failed = done.stdout.split()
    return 1e6 * float(inverse), 1e6 * float(forward), int(failed)


def reachable(kinematics: Kinematics) -> Array:
    """Random commands of the workspace that the machine reaches."""
    low, high = np.array([[c.lower, c.upper] for c in kinematics.machine.command]).T
    shape = (COMMANDS, len(low))
    command = np.random.default_rng(1).uniform(low, high, shape)
    try:
        kinematics.inverse(command)
    except AssemblyError as error:
        command = np.delete(command, error.indices, axis=0)
    return command


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:] or MACHINES:
            inverse, forward, failed = measure(name, Path(folder))
            print(
                f"{name:18s} inverse {inverse:6.2f} us, forward {forward:6.2f} us,"
                f" {failed} of {2 * CALLS} calls failed"
            )


if __name__ == "__main__":
    main()
