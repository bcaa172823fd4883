"""Runs one task of one peer in that peer's environment: `python -m peers NAME TASK`, in
the folder `benchmarks`.

Prints one line of JSON: `found` (row numbers or points), `seconds` (processor time of
the choice alone), `version`. What the package prints itself goes to the error stream.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import os
import random
import re
import sys
import warnings

import numpy as np

from peers import busy, candidates


def main() -> None:
    """Read the arguments, run, print."""
    name, number = sys.argv[1], int(sys.argv[2])
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002 - packages that draw from the global generator
    adapter = importlib.import_module(f"peers.{name}")
    task = adapter.TASKS[number]
    choose = (
        task.prepare(candidates()) if task.problem.startswith("A") else task.prepare()
    )
    start = busy()
    found = choose()
    seconds = busy() - start
    package = re.split(r"[\[=<>]", adapter.REQUIRES[0])[0]
    version = importlib.metadata.version(package)
    json.dump(
        {"found": np.asarray(found).tolist(), "seconds": seconds, "version": version},
        answer,
    )
    answer.close()
    os._exit(0)  # some packages leave threads behind


if __name__ == "__main__":
    main()
