"""Cases of the generator in this folder, which shares no code with the toolkit."""

from __future__ import annotations

import functools
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.blind.generator import cases, noise
from benchmarks.blind.true_law import true_law
from benchmarks.harness.worlds import Case

HERE = Path(__file__).resolve().parent


def draw(setting: Mapping[str, Any], number: int, folder: Path) -> Case:
    """Case `number` of a set with a seed. Raises ValueError for an unknown set."""
    case = cases.make(setting["set_seed"], setting["set"], number)
    readings = folder / f"{case.id}.readings.csv"
    cases.table(case).to_csv(readings, index=False, lineterminator="\n")
    return Case(
        name=case.id,
        study=HERE / case.stage.plan.study,
        readings=readings,
        label=cases.label(case),
        stream=(0, zlib.crc32(f"{case.id}/".encode())),
        true_law=functools.partial(
            true_law, sigma=noise.covariance(case.law, case.group)
        ),
    )
