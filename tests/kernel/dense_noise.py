"""Covariance of readings under a noise law, written out: a reference for tests."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.noise.process import Laws
from oed.noise.structure import ReadingStructure


def dense_covariance(structure: ReadingStructure, laws: Laws) -> Array:
    """Covariance (N, N) under the first of the laws, in units of the stated noise."""
    same_chain = structure.chain[:, None] == structure.chain
    run = structure.run[structure.chain]
    distance = np.abs(structure.position[:, None] - structure.position)
    carried = np.exp(-distance / laws.reach[0]) * same_chain
    single = np.diag(1.0 - laws.carried[0, structure.group])
    columns = structure.columns * laws.sizes[0, structure.kinds]
    shared = (columns @ columns.T) * (run[:, None] == run)
    course = laws.course[0] ** 2 * (structure.course @ structure.course.T)
    scale = laws.scale[0, structure.group]
    unit = single + laws.carried[0, structure.group] * carried + shared
    if structure.course.size:
        unit += course
    return np.asarray(unit * scale[:, None] * scale)
