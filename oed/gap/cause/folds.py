"""Folds of held-out readings: parts of every path, or whole runs.

Runs that repeat one another, whichever way and however often, are held out together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse, spatial
from scipy.sparse import csgraph

from oed.base import Array, Index
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers

#: number of folds
FOLDS = 5
#: share of a run's step below which joints are of the same pose
NEAR = 0.25
#: share of a run's poses that another must have for the two to repeat each other
ALIKE = 0.8
#: runs from which on the bootstrap draws whole runs; below, stretches of runs
ENOUGH = 8
#: share of the joints' extent below which a step is none
STILL = 1e-3
#: share of the joints' values below which they differ by rounding
ROUNDING = 1e-12


class Paths:
    """Which runs repeat one another, and how far along its path each reading is."""

    def __init__(self, problem: GapProblem) -> None:
        joints = [state.joints for state in problem.states]
        self._joints = carriers.at_poses(problem, joints)[:, 0]
        self._runs = problem.members
        readings = problem.rows.groupby(["setup", "run", "order"], sort=False)
        self._reading = readings.ngroup().to_numpy()
        self._setup = problem.rows["setup"].to_numpy()
        self._size = len(problem)

    def within(self) -> tuple[Index, Index]:
        """Fold (N,) of each reading, and the unit (N,) that the bootstrap draws.

        A fold is a fifth of each path; a unit is a fold of one run.
        """
        fold = np.empty(self._size, dtype=np.intp)
        for number, runs in enumerate(self.groups()):
            rows = self._rows(runs)
            longest = max((self._runs[k] for k in runs), key=len)
            place, count = self._along(rows, longest)
            is_short = count < FOLDS
            fold[rows] = (
                (place + number) % FOLDS if is_short else place * FOLDS // count
            )
        fold = np.unique(fold, return_inverse=True)[1]
        return fold, self._units(fold)

    def whole(self) -> tuple[Index, Index]:
        """As `within`, with the runs of a fold held out together.

        Units are runs, or fifths of them where runs are few.
        """
        groups = self.groups()
        if len(groups) == 1:
            groups = [[k] for k in range(len(self._runs))]
        fold = np.empty(self._size, dtype=np.intp)
        load = np.zeros(min(FOLDS, len(groups)))
        for rows in sorted(map(self._rows, groups), key=len, reverse=True):
            least = np.argmin(load)
            fold[rows] = least
            load[least] += len(rows)
        part = np.zeros(self._size, dtype=np.intp)
        if len(self._runs) < ENOUGH:
            part = self.within()[0]
        return fold, self._units(part)

    def groups(self) -> list[list[int]]:
        """Numbers of the runs that follow the same path in the same set-up.

        Direction and number of passes do not matter.
        """
        count = len(self._runs)
        near = sparse.lil_matrix((count, count))
        setups = [self._setup[members[0]] for members in self._runs]
        for setup in dict.fromkeys(self._setup):
            self._link([k for k in range(count) if setups[k] == setup], near)
        groups, label = csgraph.connected_components(near, directed=False)
        return [np.flatnonzero(label == k).tolist() for k in range(groups)]

    def _rows(self, runs: Sequence[int]) -> Index:
        """Readings of some runs."""
        return np.concatenate([self._runs[k] for k in runs])

    def _link(self, runs: list[int], near: sparse.lil_matrix) -> None:
        """Mark pairs of runs of which one has nearly all its poses in the other."""
        points = [np.unique(self._joints[self._runs[k]], axis=0) for k in runs]
        count = len(runs)
        owner = np.repeat(np.arange(count), [len(p) for p in points])
        together = np.vstack(points)
        tolerance = self._tolerance(runs, together)
        tree = spatial.cKDTree(together)
        pairs = tree.query_pairs(tolerance, output_type="ndarray")
        pairs = np.vstack([pairs, pairs[:, ::-1]])
        neighbours = np.column_stack([pairs[:, 0], owner[pairs[:, 1]]])
        neighbours = np.unique(neighbours, axis=0)
        shared = np.zeros((count, count))
        np.add.at(shared, (owner[neighbours[:, 0]], neighbours[:, 1]), 1.0)
        poses = np.bincount(owner)[:, None]
        for a, b in np.argwhere(shared >= ALIKE * poses):
            near[runs[a], runs[b]] = 1.0

    def _tolerance(self, runs: list[int], together: Array) -> float:
        """Distance in the joints below which two poses count as the same."""
        steps = []
        for k in runs:
            change = np.diff(self._joints[self._runs[k]], axis=0)
            steps.append(np.linalg.norm(change, axis=1))
        moved = np.concatenate(steps)
        extent = float(np.linalg.norm(np.ptp(together, axis=0)))
        moved = moved[moved > STILL * extent]
        by_step = NEAR * float(np.median(moved)) if moved.size else 0.0
        rounding = ROUNDING * float(np.abs(together).max())
        return max(by_step, STILL * extent, rounding)

    def _along(self, rows: Index, longest: Index) -> tuple[Index, int]:
        """Place of each row among the poses of the longest run, in its order.

        The second result is the number of places.
        """
        _, first = np.unique(self._reading[longest], return_index=True)
        template = self._joints[longest[np.sort(first)]]
        _, nearest = spatial.cKDTree(template).query(self._joints[rows])
        used, place = np.unique(nearest, return_inverse=True)
        return place.astype(np.intp), len(used)

    def _units(self, part: Index) -> Index:
        """Number (N,) of each reading's pair of run and part (N,)."""
        run = np.empty(self._size, dtype=np.intp)
        for k, members in enumerate(self._runs):
            run[members] = k
        pairs = np.column_stack([run, part])
        number = np.unique(pairs, axis=0, return_inverse=True)[1]
        return number.astype(np.intp).ravel()
