"""Newton's method on many small systems of equations at once."""

from collections.abc import Callable, Iterator

import numpy as np

from oed.base import Array, Index, Mask

#: Newton stops after a step (m, rad) below this. Convergence is quadratic, so that the
#: next step would be at rounding level.
STEP_TOLERANCE = 1e-8
#: steps after which a row has failed; shortened steps are what takes more than a few
MAX_ITERATIONS = 30
#: Longest step (m, rad). Longer ones are shortened, which keeps the assembly mode of
#: the start.
MAX_STEP = 0.2
LARGE_STEP = 0.1  #: Longest step of a large machine, over its lever
#: rows of which the slopes are in memory together: a multiple of a batch's largest chunk
BLOCK_ROWS = 8192

#: values (n, k) and slopes (n, k, k) of the rows of z, and which rows they are
Equations = Callable[[Array, Index], list[Array]]


def solve(
    equations: Equations,
    z: Array,
    step_tolerance: float = STEP_TOLERANCE,
    limited: int | None = None,
    longest: float = MAX_STEP,
) -> tuple[Array, Mask]:
    """Solve for all rows of z (n, k), in place, each until a step (m, rad) below the
    tolerance; the mask (n,) of rows that failed.

    limited  number of leading entries (a pose) whose steps are at most `longest`
    """
    failed = np.zeros(z.shape[0], dtype=bool)
    for active in blocks(len(z)):
        for _ in range(MAX_ITERATIONS):
            value, slope = equations(z[active], active)
            step = solve_linear(slope, value[..., None])[..., 0]
            size = np.abs(step).max(axis=1)
            move = np.abs(step[:, :limited]).max(axis=1)
            finite = np.isfinite(size)
            failed[active[~finite]] = True
            factor = np.minimum(1.0, longest / np.maximum(move[finite], longest))
            z[active[finite]] -= step[finite] * factor[:, None]
            active = active[finite & (size > step_tolerance)]
            if not active.size:
                break
        failed[active] = True
    return z, failed


def blocks(count: int) -> Iterator[Index]:
    """Numbers of rows in blocks whose slopes are in memory together."""
    for first in range(0, count, BLOCK_ROWS):
        yield np.arange(first, min(first + BLOCK_ROWS, count))


def longest_step(lever: float) -> float:
    """Longest step for a machine of this size (its lever, m)."""
    return max(min(MAX_STEP, lever), LARGE_STEP * lever)


def solve_linear(matrix: Array, right: Array) -> Array:
    """Solutions of matrices (n, k, k) and sides (n, k, m); NaN where singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        size = matrix.shape[-1]
        singular = np.linalg.matrix_rank(np.nan_to_num(matrix)) < size
        singular = singular[:, None, None]
        regular = np.where(singular, np.eye(size), matrix)
        return np.where(singular, np.nan, np.linalg.solve(regular, right))
