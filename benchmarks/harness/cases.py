"""The case function of the campaigns: a case is drawn, diagnosed, and kept with its label.

A setting names the world and the observer; what else it holds is the world's. The seed is
the number of the case. Observers are the diagnosis, which estimates the noise law; the same
with the true law, which costs what not knowing it does; and stepwise regression.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.harness import worlds
from benchmarks.harness.diagnosis import FAILURE, diagnose, record_or_failure
from benchmarks.harness.stepwise import stepwise_record
from benchmarks.harness.worlds import Case

if TYPE_CHECKING:
    import pandas as pd

ESTIMATED, TRUE, STEPWISE = "estimated law", "true law", "stepwise"


def diagnosis(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Label and diagnosis of a case, with `failure` where it fails.

    Raises ValueError, OSError where the world has no such case.
    """
    observer = setting["observer"]
    if observer not in (ESTIMATED, TRUE, STEPWISE):
        raise ValueError(
            f"observer {observer}: there are {ESTIMATED}, {TRUE}, {STEPWISE}"
        )
    with tempfile.TemporaryDirectory() as folder:
        case = worlds.load(setting["world"]).draw(setting, seed, Path(folder))
        if observer == TRUE and case.true_law is None:
            raise ValueError(
                f"world {setting['world']} gives no true law: leave it out"
            )
        record = record_or_failure(lambda: _observed(case, observer))
    return {"case": case.name, "label": case.label, **record}


def _observed(case: Case, observer: str) -> dict[str, Any]:
    """What an observer says of study and readings."""
    if observer == STEPWISE:
        return stepwise_record(case.study, case.readings)
    law = case.true_law if observer == TRUE else None
    return diagnose(case.study, case.readings, case.stream, law)


def verdicts(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, int]:
    """How many diagnoses failed, and what the others say."""
    counts = {"failures": int(cases[FAILURE].notna().sum()) if FAILURE in cases else 0}
    if "verdict" in cases:
        each = cases["verdict"].dropna().value_counts()
        counts |= {f"verdict {name}": int(n) for name, n in each.items()}
    return counts
