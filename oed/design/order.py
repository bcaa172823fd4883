"""The order in which poses are read: a short open path without forbidden moves.

Poses, or runs that stay together (a circle), are visited once each. Lengths may differ
there and back; inf forbids a move. A run that may be taken in both directions is two
states, of which one is visited. Paths of few runs are exact, others are searched
(`oed.design.path_search`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array, Index
from oed.design.path_search import RunStates, search_path, shortest_path

#: most runs that are ordered exactly: 2^12 subsets
EXACT = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Route:
    """Poses in the order of reading.

    indices  (n,) poses
    run      (n,) number of the run that each pose belongs to
    steps    (n,) length of the move to each pose, the first from the start (0 without)
    length   of the whole path, with the way to the finish if there is one
    exact    whether no path is shorter
    """

    indices: Index
    run: Index
    steps: Array
    length: float
    exact: bool


def order_poses(
    distance: Array,
    rng: np.random.Generator,
    start: Array | None = None,
    finish: Array | None = None,
    runs: Sequence[Sequence[int]] | None = None,
    reversible: bool = False,
    kicks: int = 200,
) -> Route:
    """A short path through all poses.

    distance    (n, n) length of each move, inf where forbidden
    start       (n,) length from where the machine stands to each pose
    finish      (n,) length from each pose to where the machine ends; None: anywhere, at
                no cost
    runs        poses of each run in its own direction, every pose once
    reversible  whether runs may be taken backwards instead; passes of a protocol in
                both directions are runs of their own (`Series.passes`)
    kicks       random changes where the path is not exact

    The path is never longer than that of nearest neighbours. Raises ValueError where no
    path without a forbidden move is found.
    """
    n = len(distance)
    members = [[i] for i in range(n)] if runs is None else [list(run) for run in runs]
    _check(distance, start, finish, members)
    if n == 0:
        nothing = np.zeros(0, np.intp)
        return Route(nothing, nothing, np.zeros(0), 0.0, True)
    lengths = np.asarray(distance, dtype=float)
    states = RunStates.of(lengths, start, finish, members, reversible)
    exact = len(members) <= EXACT
    tour = shortest_path(states) if exact else search_path(states, rng, kicks)
    length = states.length(tour)
    if not np.isfinite(length):
        problem = "there is no path" if exact else "no path was found"
        raise ValueError(
            f"{problem} through all {len(members)} runs or poses without a forbidden"
            " move: give a retract pose, or leave out poses that cannot be reached"
        )
    indices = np.concatenate([states.members[s] for s in tour])
    first_step = 0.0 if start is None else float(start[indices[0]])
    steps = np.append(first_step, distance[indices[:-1], indices[1:]])
    run_lengths = [len(states.members[s]) for s in tour]
    run = np.repeat(states.run[tour], run_lengths)
    return Route(indices, run, steps, length, exact)


def order_setups(
    costs: Array, rng: np.random.Generator, first: Array | None = None
) -> Route:
    """The order of set-ups with the least time to re-mount.

    costs (S, S) of changing from one to another, first (S,) of mounting each on the
    bare machine (`oed.design.move_times.remounting`); inf where it is impossible.
    """
    return order_poses(costs, rng, start=first)


def _check(
    distance: Array,
    start: Array | None,
    finish: Array | None,
    members: list[list[int]],
) -> None:
    n = len(distance)
    if np.shape(distance) != (n, n):
        raise ValueError(f"distances must be square, not of shape {np.shape(distance)}")
    for name, values in (("start", start), ("finish", finish)):
        if values is not None and np.shape(values) != (n,):
            raise ValueError(
                f"{name} must give one length for each of {n} poses, not be of shape"
                f" {np.shape(values)}"
            )
    off_diagonal = distance[~np.eye(n, dtype=bool)]
    ends = [values for values in (start, finish) if values is not None]
    for lengths in (off_diagonal, *ends):
        if np.isnan(lengths).any() or (lengths < 0.0).any():
            raise ValueError(
                "lengths must be numbers, not negative; inf forbids a move"
            )
    poses = sorted(pose for run in members for pose in run)
    if poses != list(range(n)) or not all(members):
        raise ValueError(
            f"runs must hold each of the poses 0 to {n - 1} once, and none may be empty"
        )
