"""Runs one task of one package in that package's environment.

Call it in the folder `benchmarks`: `python -m peers NAME TASK`, for problem A, or
`python -m peers NAME TASK FILE SIZE`, for rows (C, n) in a .npy file. It prints one line of
JSON with `indices` (row numbers), `seconds` (processor time of the choice alone) and
`version`. Output of the package itself goes to the error stream.
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

from peers import candidates, processor_seconds


def main() -> None:
    """Run the task that the command line names, and print its answer."""
    name, number = sys.argv[1], int(sys.argv[2])
    answer_stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002 - packages that draw from the global generator
    adapter = importlib.import_module(f"peers.{name}")
    prepare = adapter.TASKS[number].prepare
    by_file = len(sys.argv) > 3
    arguments = (np.load(sys.argv[3]), int(sys.argv[4])) if by_file else (candidates(),)
    choose = prepare(*arguments)
    start = processor_seconds()
    indices = choose()
    seconds = processor_seconds() - start
    package = re.split(r"[\[=<>]", adapter.REQUIRES[0])[0]
    answer = {
        "indices": np.asarray(indices).tolist(),
        "seconds": seconds,
        "version": importlib.metadata.version(package),
    }
    json.dump(answer, answer_stream)
    answer_stream.close()
    os._exit(0)  # some packages leave threads behind


if __name__ == "__main__":
    main()
