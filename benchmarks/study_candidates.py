"""Candidates of studies: of the shipped A3 and hexapod studies, and of a delta printer.

The delta is the one of `delta_v400` with a tracker that reads three coordinates of
positions in its workspace (blocks of three rows); the others read one distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

import oed
from oed.design import Candidates
from oed.design.blocks import project_on_estimable
from pkm_studies.resolve import resolve
from pkm_studies.study import Study

DELTA = {
    "schema": 1,
    "name": "delta",
    "seed": 1,
    "machine": {"model": "linear_delta"},
    "setup": [{"name": "tracker", "instrument": "pose_tracker_position"}],
    "design": {
        "criterion": "D",
        "readings": 20,
        "scaling": "tolerance",
        "candidates": [
            {
                "setup": "tracker",
                "x_mm": {"from": -100.0, "to": 100.0, "count": 11},
                "y_mm": {"from": -100.0, "to": 100.0, "count": 11},
                "z_mm": {"from": 20.0, "to": 220.0, "count": 11},
            }
        ],
    },
}


class StudyCandidates(NamedTuple):
    """Blocks (C, k, r) over the r directions that they determine; `size` are chosen."""

    name: str
    blocks: np.ndarray
    size: int


def of_studies() -> Iterator[StudyCandidates]:
    """The candidates of the three studies, without prior, as many as the study asks."""
    yield _of_study("A3 study", oed.load_study("a3_ball_bar"))
    yield _of_study("delta study", oed.build_study(DELTA))
    yield _of_study("hexapod study", oed.load_study("hexapod_ball_bar"))


def _of_study(name: str, study: Study) -> StudyCandidates:
    resolved, table = resolve(study), study.design
    measurement = resolved.measurement
    pool = Candidates.build(
        measurement, resolved.candidates, measurement.nominal, table.scaling
    )
    blocks, _ = project_on_estimable(pool.blocks, None)
    return StudyCandidates(name, blocks, table.size)
