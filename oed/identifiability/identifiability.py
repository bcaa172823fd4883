"""Identifiability of parameters: numerical rank, null directions, combinations.

Chang, Li and Li (2011), section 2.3: readings determine as many linear combinations of
the parameters as H has rank. The combinations follow from the row space of the scaled H
by Gauss-Jordan elimination, with the pivots taken from the right: each is one parameter
plus those that the readings cannot separate from it.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from oed.base import Array, Index, Mask
from oed.linear_algebra import first_largest, right_singular
from oed.measurement import Measurement, Series
from oed.model import Machine, PointGroup

#: Singular values below this share of the largest count as zero. Exact zeros come out
#: near 1e-16; the finest true sensitivities of the machines here lie above 1e-5. In
#: between are directions of no practical use, such as the eighteenth of a single circle
#: of the A3 head (4e-8), which 0.5 um noise would leave at metres.
RANK_TOLERANCE = 1e-6
ZERO_TOLERANCE = 1e-7  #: coefficients below this share of a row's largest are rounding
#: shares of a column that must be independent of the pivots, tried in turn
PIVOT_THRESHOLDS = (1e-2, 1e-4, 1e-6, 1e-9)
#: largest deviation (of a unit vector) of a null direction from a rigid motion
MOTION_TOLERANCE = 1e-5


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """Identifiability from one matrix H (N, n)."""

    names: tuple[str, ...]  #: parameters of the n columns
    singular_values: Array  #: (n,) of the scaled H; 0 where there are fewer readings
    rank: int  #: numerical rank
    tolerance: float  #: share of the largest singular value that counts as zero
    row_space: Array  #: (rank, n) orthonormal rows, in scaled parameters
    null_space: Array  #: (n - rank, n) orthonormal rows, in scaled parameters
    #: (rank, n) coefficients of the combinations of SI parameters that the readings
    #: determine; 1 at the pivot
    combinations: Array
    lost: Array  #: (n - rank, n) changes of SI parameters that change no reading

    @property
    def identifiable_singular_values(self) -> Array:
        """Singular values (rank,) that count as non-zero."""
        return self.singular_values[: self.rank]

    def coefficients_by_name(self, rows: Array) -> list[dict[str, float]]:
        """Rows (k, n) of coefficients by parameter, zeros left out."""
        named = []
        for row in rows:
            pairs = zip(self.names, row, strict=True)
            named.append({name: float(value) for name, value in pairs if value != 0.0})
        return named


def analyse(
    h: Array, names: Sequence[str], scale: Array, tolerance: float = RANK_TOLERANCE
) -> Identifiability:
    """Identifiability from H (N, n), whose columns were multiplied by `scale` (n,).

    H has the columns of free parameters only. Raises ValueError where the numbers of
    columns, names and scales differ.

    Two legs whose sum alone is read:

    >>> import numpy as np
    >>> from oed.identifiability import analyse
    >>> h = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    >>> verdict = analyse(h, ["l1", "l2"], scale=np.ones(2))
    >>> verdict.rank
    1
    """
    n = h.shape[1]
    if n != len(names) or n != len(scale):
        raise ValueError(
            f"H has {n} columns for {len(names)} names and {len(scale)} scales"
        )
    values, vectors = right_singular(h)
    threshold = tolerance * max(float(values[0]), 1e-300)
    rank = int(np.count_nonzero(values > threshold))
    row_space, null_space = vectors[:rank], vectors[rank:]
    return Identifiability(
        names=tuple(names),
        singular_values=values,
        rank=rank,
        tolerance=tolerance,
        row_space=row_space,
        null_space=null_space,
        combinations=_combinations(echelon(row_space), scale),
        lost=_directions(echelon(null_space), scale),
    )


def echelon(space: Array) -> Array:
    """A basis (k, n), an identity at pivots from the right. Raises LinAlgError."""
    if space.shape[0] == 0:
        return space
    pivots = _pivots(space)
    rows = np.linalg.solve(space[:, pivots], space)
    largest = np.abs(rows).max(axis=1, keepdims=True)
    basis: Array = np.where(np.abs(rows) < ZERO_TOLERANCE * largest, 0.0, rows)
    basis[:, pivots] = np.eye(
        len(rows)
    )  # nearly dependent pivots leave rounding errors
    return basis


def _pivots(space: Array) -> Index:
    """Independent columns (k,), the farthest right, by a threshold that allows k."""
    for threshold in PIVOT_THRESHOLDS:
        pivots = _independent_columns(space, threshold)
        if len(pivots) == space.shape[0]:
            return np.array(pivots[::-1], dtype=np.intp)
    raise np.linalg.LinAlgError(
        "no independent columns found: the row space is not finite or not of full rank"
    )


def _independent_columns(space: Array, threshold: float) -> list[int]:
    """As many independent columns as the space has rows, from the right."""
    rank = space.shape[0]
    pivots: list[int] = []
    basis = np.zeros((rank, 0))
    for j in range(space.shape[1] - 1, -1, -1):
        column = space[:, j]
        residual = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(residual))
        if size > threshold * max(float(np.linalg.norm(column)), threshold):
            basis = np.column_stack([basis, residual / size])
            pivots.append(j)
        if len(pivots) == rank:
            break
    return pivots


def _combinations(rows: Array, scale: Array) -> Array:
    """Combinations (k, n) of SI parameters, from an echelon in scaled ones.

    A combination weighs p / scale. Its coefficient is 1 at the pivot, the last entry
    that is 1, or at the first entry, where that only changes the sign.
    """
    combinations = np.empty_like(rows)
    for k, row in enumerate(rows):
        pivot = np.flatnonzero(np.abs(row - 1.0) < 1e-9)[-1]
        weights = row / scale * scale[pivot]
        first = weights[np.flatnonzero(weights)[0]]
        flipped = abs(first + 1.0) < 1e-9
        combinations[k] = weights / first if flipped else weights
    return combinations


def _directions(rows: Array, scale: Array) -> Array:
    """Changes (k, n) of SI parameters, largest 1, from an echelon in scaled ones."""
    directions = np.empty_like(rows)
    for k, row in enumerate(rows):
        change = row * scale
        directions[k] = change / change[first_largest(change)]
    return directions


@dataclasses.dataclass(frozen=True, slots=True)
class RigidMotion:
    """A rigid motion of a group of joint centres: its text, and the change (n,), SI."""

    text: str
    direction: Array


def rigid_motions(machine: Machine, names: Sequence[str]) -> list[RigidMotion]:
    """Rigid motions of the machine's point groups that move free `names` only."""
    kinds = ("translation", "rotation")
    motions = []
    for group in machine.groups:
        for kind, axis in itertools.product(kinds, range(3)):
            direction = _group_motion(group, names, kind, axis)
            if direction is None:
                continue
            about = f"along {'xyz'[axis]}"
            if kind == "rotation":
                about = f"about {group.origin}, {'xyz'[axis]} axis"
            text = f"{kind} of the {group.name} {about}"
            motions.append(RigidMotion(text, direction))
    return motions


def _group_motion(
    group: PointGroup, names: Sequence[str], kind: str, axis: int
) -> Array | None:
    """Change (n,) of the free parameters; None where others would have to move."""
    index = {name: k for k, name in enumerate(names)}
    direction = np.zeros(len(names))
    unit = np.eye(3)[axis]
    for parameters, point in group.points:
        move = unit if kind == "translation" else np.cross(unit, point)
        for name, value in zip(parameters, move, strict=True):
            if name in index:
                direction[index[name]] = value
            elif abs(value) > 1e-12:
                return None
    return direction


def lost_motions(
    identified: Identifiability, machine: Machine, scale: Array
) -> tuple[list[str], Array]:
    """Rigid motions that no reading determines, as texts, and rows (k, n) of what has
    none.

    A set-up's unknowns may move along: such a direction is a N with (a N)_machine =
    u_machine, N the null space and u the motion.
    """
    null_space = identified.null_space
    if not len(null_space):
        return [], null_space
    of_machine = np.array(["." not in name for name in identified.names])
    texts: list[str] = []
    directions: list[Array] = []
    for motion in rigid_motions(machine, identified.names):
        target = motion.direction / scale
        target /= np.linalg.norm(target)
        lost = _null_direction(null_space, target, of_machine)
        if lost is not None:
            texts.append(motion.text + _setups_along(identified.names, lost))
            directions.append(lost / np.linalg.norm(lost))
    if not directions:
        return texts, null_space
    basis = np.linalg.qr(np.array(directions).T)[0]
    remainder = null_space - null_space @ basis @ basis.T
    _, values, vectors = np.linalg.svd(remainder, full_matrices=False)
    return texts, vectors[values > 1e-6]


def _null_direction(null_space: Array, target: Array, of_machine: Mask) -> Array | None:
    """Null direction (n,) that moves the machine as wanted (n,); None if none does."""
    moves = null_space[:, of_machine].T
    factors = np.linalg.lstsq(moves, target[of_machine], rcond=None)[0]
    direction = factors @ null_space
    deviation = direction[of_machine] - target[of_machine]
    if np.linalg.norm(deviation) < MOTION_TOLERANCE:
        return direction
    return None


def _setups_along(names: Sequence[str], direction: Array) -> str:
    """The set-ups that move along with a direction (n,), in words."""
    setups = []
    for name, value in zip(names, direction, strict=True):
        setup, _, _ = name.rpartition(".")
        if setup and abs(value) > 1e-6:
            setups.append(setup)
    if not setups:
        return ""
    return f" together with what {' and '.join(dict.fromkeys(setups))} is set up on"


#: scalings of the parameter columns, which a report must never mix: SI units; every
#: parameter as a length, angles times the machine's lever (the papers' d * dbeta), noise
#: 1; in units of its prior standard deviation, readings in units of their noise, so that
#: a singular value of 1 determines a direction as well as the drawing does
Scaling = Literal["si", "length", "tolerance"]


def column_scale(measurement: Measurement, scaling: Scaling) -> Array:
    """Factor (n,) by which each column of H is multiplied."""
    if scaling == "si":
        return np.ones(len(measurement.parameters))
    if scaling == "length":
        return 1.0 / measurement.length_factors
    if scaling == "tolerance":
        return measurement.tolerance
    raise ValueError(f"scaling {scaling!r} is none of {get_args(Scaling)}")


def scaled(
    measurement: Measurement, series: Sequence[Series], theta: Array, scaling: Scaling
) -> Array:
    """H (N, n) at theta (n,), scaled; "length" as lengths, "tolerance" whitened."""
    jacobian = measurement.jacobian(series, theta)
    return scaled_jacobian(measurement, series, jacobian, scaling)


def scaled_jacobian(
    measurement: Measurement,
    series: Sequence[Series],
    jacobian: Array,
    scaling: Scaling,
) -> Array:
    """`scaled`, from the Jacobian (N, n) of the readings, SI."""
    rows = jacobian * column_scale(measurement, scaling)
    if scaling == "tolerance":
        return measurement.noise(series).whiten(rows)
    if scaling == "length":
        return rows * measurement.reading_length_factors(series)[:, None]
    return rows


def prior_information(measurement: Measurement) -> Array:
    """Information (k, k) of the prior on the k free parameters, in tolerance units."""
    free = np.flatnonzero(measurement.free)
    correlation = measurement.correlation
    if correlation is None:
        return np.eye(len(free))
    block = correlation[np.ix_(free, free)]
    return np.asarray(np.linalg.inv(block), dtype=float)


def parameter_covariance(
    measurement: Measurement, series: Sequence[Series], theta: Array
) -> Array:
    """Posterior covariance (n, n), SI, of theta from readings at theta (n,)."""
    white = measurement.noise(series).whiten(measurement.jacobian(series, theta))
    scaled = posterior_covariance(measurement.in_prior_units(white))
    return measurement.from_prior_units(scaled)


def posterior_covariance(h: Array) -> Array:
    """Covariance (I + H^T H)^-1 (n, n), in units of the tolerances.

    H (N, n) is in "tolerance" scaling. The singular values give directions that no
    reading determines exactly their prior variance 1.
    """
    readings, n = h.shape
    # all n right vectors are needed, but never a square of the many readings
    _, singular_values, vt = np.linalg.svd(h, full_matrices=readings < n)
    gain = np.zeros(n)
    gain[: singular_values.size] = singular_values**2
    return np.asarray((vt.T / (1.0 + gain)) @ vt)
