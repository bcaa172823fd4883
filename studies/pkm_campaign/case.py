"""One case of a campaign: a setting and a seed in, a row of figures out."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from oed.estimation import IdentificationError
from oed.mechanism import AssemblyError

#: columns of every case: what a case function returns has other names
SEED, ERROR, PROCESSOR_TIME = "seed", "error", "cpu_s"
COLUMNS = (SEED, ERROR, PROCESSOR_TIME)

#: failures of a case that are no fault of what computes it
EXPECTED = (IdentificationError, AssemblyError, np.linalg.LinAlgError)

#: computes the figures of a setting and a seed, as numbers, texts and truth values
Figures = Callable[[Mapping[str, Any], int], Mapping[str, Any]]


@dataclasses.dataclass(frozen=True, slots=True)
class Case:
    """What a process needs for a row.

    figures    computes them
    setting    the varied values by field
    seed       of the case
    """

    figures: Figures
    setting: Mapping[str, Any]
    seed: int


def evaluate(case: Case) -> dict[str, Any]:
    """The row of a case: its setting and seed, its figures, processor time in s.

    A case that cannot be fitted or assembled has its reason in `error`, and no figures.
    """
    row: dict[str, Any] = {**case.setting, SEED: case.seed, ERROR: ""}
    begin = time.process_time()
    try:
        row |= case.figures(case.setting, case.seed)
    except EXPECTED as error:
        row[ERROR] = str(error)
    return {**row, PROCESSOR_TIME: round(time.process_time() - begin, 4)}
