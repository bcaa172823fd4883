"""The board of real machines, as the page of the documentation.

python -m benchmarks.real_data --data ../shared/data --out docs/benchmarks/real_data.md
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import tempfile
from pathlib import Path

from benchmarks.real_data import page
from benchmarks.real_data.entries import ENTRIES
from benchmarks.real_data.run import Outcome, run


def main() -> None:
    """Run the entries whose data are there, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the data")
    parser.add_argument("--out", type=Path, help="page to write; printed without")
    given = parser.parse_args()
    outcomes: list[Outcome] = []
    for entry in ENTRIES:
        if not (given.data / entry.folder).is_dir():
            print(f"{entry.name}: no data in {given.data / entry.folder}")
            continue
        with tempfile.TemporaryDirectory() as work:
            outcomes.append(run(entry, given.data, Path(work)))
        print(f"{entry.name}: {len(outcomes[-1].rows)} predicted channels", flush=True)
    text = page.markdown(outcomes)
    if given.out is None:
        print(text)
    else:
        given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
