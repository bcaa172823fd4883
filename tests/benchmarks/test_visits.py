"""The benchmark of second visits: one machine in both visits, and what its table counts."""

from typing import Any

import numpy as np
import pytest

from benchmarks.second.world import GENERATOR
from benchmarks.visits import cases, later

NO_GENERATOR = not (GENERATOR / "make.py").is_file()


@pytest.mark.skipif(NO_GENERATOR, reason="needs the second generator")
def test_a_run_that_is_read_again_reads_the_same():
    """A null case without noise at the poses of its own first run of the planar machine."""
    make = later.modules(GENERATOR)
    first = later.draw(make, "planar", "null", "white", 0.0, (7, 1))
    case = first.case
    k = next(i for i, run in enumerate(case.runs) if run["dir"] > 0)
    rows = np.flatnonzero(case.run == k)
    run = {
        "setup": int(case.setup[rows[0]]),
        "poses": {name: np.asarray(v)[rows] for name, v in case.cmd.items()},
        "dir": 1,
        "feed": case.feed[rows[0]],
        "payload": case.payload[rows[0]],
    }
    y, clock = later.visit_again(make, first, [run])
    before = first.y[np.isin(case.row, rows)]
    scatter = np.std(y - before) / case.sigma[0]
    assert scatter < 3.0
    assert np.ptp(y) > 1e4 * case.sigma[0]
    assert clock.min() > case.t.max()


def record(before: bool, after: bool | None, predicted: float = 0.9) -> dict[str, Any]:
    def answer(right: bool) -> dict[str, Any]:
        flags = ("class", "right", "likeliest_right")
        return {**dict.fromkeys(flags, right), "clear": True, "both_visible": False}

    found = {"kind": "single", "first": answer(before), "readings": 100}
    if after is None:
        return {**found, "visited": False}
    second = {"second": answer(after), "further": 25, "now": 0.5}
    return {**found, "visited": True, "predicted": predicted, **second}


def test_the_answer_that_stands_is_the_last_one():
    cases_of = [record(True, None), record(False, True), record(False, False)]
    text = cases.table([*cases_of, {"failure": "out of reach"}])
    assert "4 cases, 1 left out, 2 visited again" in text
    row = next(line for line in text.splitlines() if line.startswith("| right class |"))
    assert row.split("|")[2].strip().startswith("0.33")
    assert row.split("|")[3].strip().startswith("0.67")
    last = text.splitlines()[-1]
    assert "| 2 | 0.50 | 0.90 | 0.00" in last
    assert "| 0.50 (" in last
