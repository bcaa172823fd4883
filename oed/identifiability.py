"""What a set of readings can tell apart: numerical rank, lost directions, minimal
linear combinations.

Chang, Li and Li (2011), section 2.3: the readings determine as many linear combinations
of the parameters as H has rank. They are found here from the row space of the scaled H
by Gauss-Jordan elimination, with the pivots taken from the right, so that each
combination is told by one parameter plus what cannot be told apart from it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.machine import Machine

#: singular values below this share of the largest count as zero. Exact zeros come out
#: near 1e-16; the finest true sensitivities of the machines here lie above 1e-5. In
#: between are directions of no practical use, such as the eighteenth of a single circle
#: of the A3 head (4e-8), which 0.5 um noise would leave at metres.
RANK_TOLERANCE = 1e-6
#: coefficients below this (with parameters in their scaled unit) are rounding
ROUNDING = 1e-7
PIVOTS = (1e-2, 1e-4, 1e-6, 1e-9)


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Verdict on one identification matrix.

    names            parameters of the n columns
    singular_values  (n,) of the scaled H, padded with zeros where there are fewer
                     readings than parameters
    rank, tolerance  numerical rank, and the share of the largest singular value that
                     counts as zero
    row_space        (rank, n) orthonormal, in scaled parameters
    null_space       (n - rank, n) orthonormal, in scaled parameters
    combinations     (rank, n) coefficients, in SI parameters: what is determined;
                     coefficient 1 at its pivot
    lost             (n - rank, n) coefficients, in SI parameters: directions that
                     change no reading
    """

    names: tuple[str, ...]
    singular_values: Array
    rank: int
    tolerance: float
    row_space: Array
    null_space: Array
    combinations: Array
    lost: Array

    @property
    def identifiable_singular_values(self) -> Array:
        """Singular values (rank,) of the identifiable directions."""
        return self.singular_values[: self.rank]

    def coefficients_by_name(self, rows: Array) -> list[dict[str, float]]:
        """Rows of coefficients as {parameter: coefficient}, zeros left out."""
        return [
            {n: float(c) for n, c in zip(self.names, row, strict=True) if c != 0.0}
            for row in rows
        ]


def analyse(
    h: Array, names: Sequence[str], scale: Array, tolerance: float = RANK_TOLERANCE
) -> Identifiability:
    """Identifiability of a scaled H (N, n) whose columns were multiplied by `scale`
    (n,).

    Only free parameters belong here: leave out the columns that are held.
    """
    if h.shape[1] != len(names) or h.shape[1] != len(scale):
        raise ValueError(
            f"H has {h.shape[1]} columns for {len(names)} names and {len(scale)} scales"
        )
    _, s, vt = np.linalg.svd(h, full_matrices=True)
    values = np.zeros(h.shape[1])
    values[: s.size] = s
    rank = int(np.count_nonzero(values > tolerance * max(float(values[0]), 1e-300)))
    return Identifiability(
        names=tuple(names),
        singular_values=values,
        rank=rank,
        tolerance=tolerance,
        row_space=vt[:rank],
        null_space=vt[rank:],
        combinations=_in_si(echelon(vt[:rank]), scale, flip=False),
        lost=_in_si(echelon(vt[rank:]), scale, flip=True),
    )


def echelon(space: Array) -> Array:
    """Basis of the same row space with an identity at its pivot columns, pivots found
    from the right.
    """
    if space.shape[0] == 0:
        return space
    pivots = _pivots(space)
    rows = np.linalg.solve(space[:, pivots], space)
    return np.where(
        np.abs(rows) < ROUNDING * np.abs(rows).max(axis=1, keepdims=True), 0.0, rows
    )


def _pivots(space: Array) -> Index:
    """Independent columns, the rightmost first; the threshold is lowered until there
    are enough.
    """
    rank = space.shape[0]
    for threshold in PIVOTS:
        found: list[int] = []
        basis = np.zeros((rank, 0))
        for j in range(space.shape[1] - 1, -1, -1):
            rest = space[:, j] - basis @ (basis.T @ space[:, j])
            size = float(np.linalg.norm(rest))
            if size > threshold * max(float(np.linalg.norm(space[:, j])), threshold):
                basis, found = np.column_stack([basis, rest / size]), [*found, j]
            if len(found) == rank:
                return np.array(found[::-1], dtype=np.intp)
    raise np.linalg.LinAlgError(
        "no independent columns found: the row space is not finite or not of full rank"
    )


def _in_si(rows: Array, scale: Array, *, flip: bool) -> Array:
    """Coefficients for SI parameters. A combination weighs p/scale, a direction moves p
    by scale.

    Combinations keep coefficient 1 at the pivot (the last entry that is 1), or at their
    first entry where that only flips the sign; directions are normalised to their
    largest entry.
    """
    told = []
    for row in rows:
        if flip:
            move = row * scale
            told.append(move / move[np.argmax(np.abs(move))])
            continue
        pivot = _pivot_of(row)
        weights = row / scale * scale[pivot]
        first = weights[np.flatnonzero(weights)[0]]
        told.append(weights / first if abs(first + 1.0) < 1e-9 else weights)
    return np.array(told).reshape(len(rows), rows.shape[1] if rows.ndim == 2 else 0)


def _pivot_of(row: Array) -> int:
    ones = np.flatnonzero(np.abs(row - 1.0) < 1e-9)
    return int(ones[-1])


@dataclasses.dataclass(frozen=True, slots=True)
class RigidMotion:
    """A named direction in parameter space: a rigid motion of a group of joint centres."""

    text: str
    direction: Array


def rigid_motions(machine: Machine, names: Sequence[str]) -> list[RigidMotion]:
    """Rigid motions of the machine's point groups that move free parameters only, over
    columns `names`.
    """
    position = {n: k for k, n in enumerate(names)}
    motions = []
    for group in machine.groups:
        for kind, axis in (
            (k, a) for k in ("translation", "rotation") for a in range(3)
        ):
            direction, complete = np.zeros(len(names)), True
            unit = np.eye(3)[axis]
            for parameters, place in group.points:
                move = unit if kind == "translation" else np.cross(unit, place)
                for name, value in zip(parameters, move, strict=True):
                    if name in position:
                        direction[position[name]] = value
                    elif abs(value) > 1e-12:
                        complete = False
            if complete:
                about = (
                    f"along {'xyz'[axis]}"
                    if kind == "translation"
                    else f"about {group.origin}, {'xyz'[axis]} axis"
                )
                motions.append(
                    RigidMotion(f"{kind} of the {group.name} {about}", direction)
                )
    return motions


def lost_motions(
    verdict: Identifiability, machine: Machine, scale: Array
) -> tuple[list[str], Array]:
    """Names of the rigid motions that no reading sees, and what is left of the null
    space (k, n) beside them.

    A set-up's unknowns may go along: a base that moves together with the cup on it
    changes no bar's reading. With N the null space and u the motion, such a direction
    is a N with (a N)_machine = u_machine.
    """
    found: list[Array] = []
    texts: list[str] = []
    own = np.array(["." not in n for n in verdict.names])
    for motion in (
        rigid_motions(machine, verdict.names) if len(verdict.null_space) else []
    ):
        u = motion.direction / scale
        u /= np.linalg.norm(u)
        lost = (
            np.linalg.lstsq(verdict.null_space[:, own].T, u[own], rcond=None)[0]
            @ verdict.null_space
        )
        if np.linalg.norm(lost[own] - u[own]) < 1e-5:
            along = [
                n
                for n, v in zip(verdict.names, lost, strict=True)
                if "." in n and abs(v) > 1e-6
            ]
            places = dict.fromkeys(n.rpartition(".")[0] for n in along)
            texts.append(
                motion.text
                + (
                    f" together with what {' and '.join(places)} is set up on"
                    if places
                    else ""
                )
            )
            found.append(lost / np.linalg.norm(lost))
    if not found:
        return texts, verdict.null_space
    basis = np.linalg.qr(np.array(found).T)[0]
    rest = verdict.null_space - verdict.null_space @ basis @ basis.T
    _, s, vt = np.linalg.svd(rest, full_matrices=False)
    return texts, vt[s > 1e-6]
