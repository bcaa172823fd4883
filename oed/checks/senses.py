"""Runs whose order of poses and whose column `direction` contradict each other.

Two runs through the same poses in the same order have one sense of travel, in opposite
orders two. Effects of the sense (play, friction) follow the order.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy import spatial

from oed.base import Array, Index
from oed.checks.session import SessionReadings
from oed.dataset import Row

#: share of steps that must agree
AGREEING_SHARE = 0.75
#: joints are equal to so much of their largest difference
JOINT_TOLERANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class Contradiction:
    """Two runs through the same poses; rows are those that open each run.

    same_order  whether they pass the poses in the same order
    """

    runs: tuple[str, str]
    rows: tuple[Row, Row]
    same_order: bool


@dataclasses.dataclass(frozen=True)
class _Run:
    name: str
    setup: str
    row: Row
    direction: float
    joints: Array


def contradictions(session: SessionReadings) -> list[Contradiction]:
    """Pairs of runs whose orders and directions do not go together."""
    if "direction" not in session.values.columns:
        return []
    pairs = []
    for one, other in itertools.combinations(_runs(session), 2):
        if one.setup != other.setup:
            continue
        sense = _relative_sense(one.joints, other.joints)
        if sense * one.direction * other.direction < 0.0:
            rows = (one.row, other.row)
            pairs.append(Contradiction((one.name, other.name), rows, sense > 0.0))
    return pairs


def _runs(session: SessionReadings) -> list[_Run]:
    """Runs with one direction throughout, their joints in the order of travel."""
    runs = []
    for setup, run, rows in session.ordered_runs():
        directions = np.unique(rows["direction"].to_numpy(dtype=float))
        if len(directions) != 1 or abs(directions[0]) != 1.0:
            continue
        path = session.joints[rows["reading"].to_numpy()]
        first = rows["row"].iloc[0]
        runs.append(_Run(run, setup, first, float(directions[0]), path))
    return runs


def _relative_sense(one: Array, other: Array) -> float:
    """+1 where two paths (n, nq), (m, nq) pass their common poses in the same order.

    -1 in the opposite one; 0 where that cannot be said.
    """
    size = max(float(np.ptp(one, axis=0).max()), 1e-12)
    near = _pairs_within(one, other, JOINT_TOLERANCE * size)
    count_one = np.bincount(near[:, 0], minlength=len(one))
    count_other = np.bincount(near[:, 1], minlength=len(other))
    unique = (count_one[near[:, 0]] == 1) & (count_other[near[:, 1]] == 1)
    poses = near[unique]
    if len(poses) < 4:
        return 0.0
    rank = np.argsort(np.argsort(poses[:, 1]))
    steps = np.diff(rank) % len(rank)
    forward = float(np.mean(steps == 1))
    backward = float(np.mean(steps == len(rank) - 1))
    if forward >= AGREEING_SHARE:
        return 1.0
    return -1.0 if backward >= AGREEING_SHARE else 0.0


def _pairs_within(one: Array, other: Array, size: float) -> Index:
    """Pairs (p, 2) of places (n, k) and (m, k) less than a size apart, in order.

    The largest difference of a coordinate counts.
    """
    tree = spatial.cKDTree(other)
    near = tree.query_ball_point(one, size, p=np.inf, return_sorted=True)
    first = np.repeat(np.arange(len(one)), [len(places) for places in near])
    pairs = np.column_stack([first, np.array([k for n in near for k in n], dtype=int)])
    apart = np.abs(one[pairs[:, 0]] - other[pairs[:, 1]]).max(axis=1, initial=0.0)
    return np.asarray(pairs[apart < size], dtype=np.intp)
