"""Covariance of readings under a noise law, written out: a reference for tests."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index
from oed.noise.law import STATED_LAW, NoiseLaw
from oed.noise.process import Laws
from oed.noise.runs import Runs
from oed.noise.stated import StatedErrors
from oed.noise.structure import ReadingStructure


def dense_covariance(structure: ReadingStructure, laws: Laws) -> Array:
    """Covariance (N, N) under the first of the laws, in units of the stated noise."""
    same_chain = structure.chain[:, None] == structure.chain
    run = structure.run[structure.chain]
    distance = np.abs(structure.position[:, None] - structure.position)
    carried = np.exp(-distance / laws.reach[0]) * same_chain
    single = (1.0 - laws.carried[0]) * np.eye(len(structure))
    columns = structure.columns * laws.sizes[0, structure.kinds]
    shared = (columns @ columns.T) * (run[:, None] == run)
    course = laws.course[0] ** 2 * (structure.course @ structure.course.T)
    scale = laws.scale[0, structure.group]
    unit = single + laws.carried[0] * carried + shared
    if structure.course.size:
        unit += course
    return np.asarray(unit * scale[:, None] * scale)


def stated_root(stated: StatedErrors, members: Index) -> Array:
    """What relates the channels of readings (k,) of one run, R (k, k)."""
    inverse = stated.inverse[members][:, members].toarray()
    return np.asarray(np.linalg.inv(inverse))


def stated_correlation(runs: Runs, members: Index) -> Array:
    """Correlation (k, k) of the stated errors of readings (k,) of one run."""
    return law_covariance(STATED_LAW, runs, members)


def law_covariance(law: NoiseLaw, runs: Runs, members: Index) -> Array:
    """Covariance (k, k) of readings of one run under a law of the diagnosis."""
    channel = runs.channel[members]
    same = channel[:, None] == channel
    place, share, reach = runs.position[members], law.ar1_sd**2, law.ar1_length
    single, root = law.variance * np.ones(len(members)), np.eye(len(members))
    covariance = np.zeros((len(members), len(members)))
    if runs.stated is not None:
        shared = runs.stated.shared[members]
        covariance += law.variance * (shared @ shared.T)
        root = stated_root(runs.stated, members)
        if runs.stated.carried:
            place, reach = runs.stated.place[members], runs.stated.reach
            share = runs.stated.carried * law.variance
            single -= share
        else:
            single *= np.diag(root) ** 2
            root = root / np.diag(root)
    distance = np.abs(place[:, None] - place)
    alone = np.diag(single) + share * np.exp(-distance / reach) * same
    covariance += root @ alone @ root.T
    level, seat = runs.levels[members], runs.seat[members]
    common = law.run_sd**2 * np.outer(level, level) + law.seat_sd**2 * (seat @ seat.T)
    covariance += np.where(same, common, 0.0)
    ratio = np.ones(len(members))
    if law.channel_ratio is not None:
        ratio = law.channel_ratio[members]
    return np.asarray(law.level**2 * covariance * np.outer(ratio, ratio))
