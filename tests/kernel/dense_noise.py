"""Covariance of readings under a noise law, written out: a reference for tests."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw
from oed.noise.process import Laws
from oed.noise.structure import ReadingStructure


def dense_covariance(
    structure: ReadingStructure, laws: Laws, members: Index | slice = slice(None)
) -> Array:
    """Covariance (k, k) of readings under the first of the laws, over the stated noise."""
    chain, position = structure.chain[members], structure.position[members]
    run, distance = structure.run[chain], np.abs(position[:, None] - position)
    carried = np.exp(-distance / laws.reach[0]) * (chain[:, None] == chain)
    single = (1.0 - laws.carried[0]) * np.eye(len(chain))
    columns = structure.columns[members] * laws.sizes[0, structure.kinds]
    shared = (columns @ columns.T) * (run[:, None] == run)
    scale = laws.scale[0, structure.group[members]]
    unit = single + laws.carried[0] * carried + shared
    if structure.course.size:
        course = structure.course[members]
        unit += laws.course[0] ** 2 * (course @ course.T)
    return np.asarray(unit * scale[:, None] * scale)


def law_covariance(law: NoiseLaw, problem: GapProblem, members: Index) -> Array:
    """Covariance (k, k) of readings of one run under a law, in the problem's units."""
    structure = problem.structure
    standard = law.level**2 * dense_covariance(structure, law.law, members)
    root = np.diag(structure.unit[members])
    if structure.decouple is not None:
        root = np.linalg.inv(structure.decouple[members][:, members].toarray())
    return np.asarray(root @ standard @ root.T)
