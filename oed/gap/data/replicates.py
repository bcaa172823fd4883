"""Readings taken again at the same pose in the same way, and what differs between them.

What such readings do not share is noise, whatever acts on the machine: they measure the
noise and nothing else. Readings taken again at once are repeats on the spot. Those of a
later run, as of a reference circle between the others, have all other noise as well.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw

#: share of the largest value of a column below which two values are the same
ROUNDING = 1e-9
#: poses that count, evenly over all of them: time and memory stay linear in the readings
MOST = 200
#: columns of the readings' rows that say how a pose was reached
CONDITIONS = ("direction", "feed", "payload")


@dataclasses.dataclass(frozen=True, eq=False)
class Replicates:
    """Readings that were taken more than once.

    rows        (k,) numbers of these readings
    cell        (k,) number of the pose, conditions and channel that each belongs to
    on_the_spot whether all were taken again within their run
    """

    rows: Index
    cell: Index
    on_the_spot: bool

    def energy(self, problem: GapProblem, law: NoiseLaw) -> tuple[float, int]:
        """Whitened energy of what differs between them, and its degrees of freedom."""
        if not len(self.rows):
            return 0.0, 0
        factor = law.factor(problem, self.rows)
        same = np.zeros((len(problem), int(self.cell.max()) + 1))
        same[self.rows, self.cell] = 1.0
        held = factor.whiten(np.hstack([same, problem.slopes]))
        white = factor.whiten(problem.residual[:, None])[:, 0]
        return energy_beyond(white, held)


def energy_beyond(white: Array, held: Array) -> tuple[float, int]:
    """Energy of white values (k,) outside columns (k, c), and its degrees of freedom."""
    directions, sizes, _ = linalg.svd(held, full_matrices=False, check_finite=False)
    axes = directions[:, sizes > ROUNDING * sizes.max(initial=0.0)]
    outside = white - axes @ (axes.T @ white)
    return float(outside @ outside), len(white) - axes.shape[1]


def replicates(problem: GapProblem) -> Replicates:
    """Readings of one channel that share poses, senses of motion and conditions."""
    cell = pd.factorize(pd.Series(list(map(tuple, _keys(problem)))))[0]
    often = np.bincount(cell)[cell] > 1
    poses = np.unique(cell[often])
    chosen = np.linspace(0, len(poses) - 1, min(len(poses), MOST)).astype(np.intp)
    rows = np.flatnonzero(np.isin(cell, poses[chosen]))
    numbers = np.unique(cell[rows], return_inverse=True)[1].astype(np.intp)
    run = np.empty(len(problem), dtype=np.intp)
    for k, members in enumerate(problem.members):
        run[members] = k
    runs_of = pd.Series(run[rows]).groupby(numbers).nunique()
    return Replicates(rows, numbers, bool((runs_of == 1).all()))


def _keys(problem: GapProblem) -> Array:
    """(N, c) whole numbers that are equal where two readings are taken the same way."""
    parts = []
    for number, (series, state) in enumerate(
        zip(problem.series, problem.states, strict=True)
    ):
        channels = len(problem.measurement.setups[series.setup].instrument.channels)
        poses = np.hstack([state.joints, state.motion_sign])
        read = poses[series.index].reshape(len(series.index), -1)
        rows = np.repeat(_numbers(read), channels)
        parts.append(np.column_stack([np.full(len(rows), number), rows]))
    keys = [np.vstack(parts), problem.channel]
    given = [name for name in CONDITIONS if name in problem.rows]
    conditions = problem.rows[given].fillna(0.0).to_numpy(dtype=float)
    return np.column_stack([*keys, _numbers(conditions)])


def _numbers(values: Array) -> Index:
    """Number (n,) of each distinct row of values (n, c), rounding apart."""
    unit = ROUNDING * np.maximum(np.abs(values).max(axis=0, initial=0.0), ROUNDING)
    whole = np.round(np.nan_to_num(values) / (10.0 * unit)).astype(np.int64)
    return np.unique(whole, axis=0, return_inverse=True)[1].ravel()
