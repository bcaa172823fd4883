"""Where to read the errors of a forecast grid: readings of least predicted variance.

A field of errors is a sum of its leading Karhunen-Loeve modes with unit normal
coefficients, besides a trend. Then a reading is a row, and the mean variance over the
box is criterion I with a prior, for which `oed.design.exchange` chooses the places and
certifies them.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.compensate.error_field import LENGTH, Box, Kernel, Motion
from oed.compensate.table import grid_nodes
from oed.design.criterion import Variance
from oed.design.exchange import choose

#: candidate places along an axis, by the number of axes; further ones have the last
CANDIDATES = (41, 11, 6, 4)
#: share of a field's variance that its modes hold, and most modes of a component
ENERGY, MODES = 0.999, 40
#: standard deviation of the trend's coefficients over the size of the field
TREND = 10.0
#: rounds of the design's local search
ROUNDS = 1


@dataclasses.dataclass(frozen=True)
class GridDesign:
    """Places to read, with their certificate.

    places      (n, a) SI
    predicted   (k,) rms error that interpolation between these readings leaves, SI
    efficiency  share of the readings that the best plan would need
    """

    places: Array
    predicted: Array
    efficiency: float | None


def expected_kernel(size: float, axes: int) -> Kernel:
    """The kernel before any reading: the discrepancy's, Matern's of order 3/2.

    size  standard deviation that calibration is expected to leave, SI
    """
    return Kernel("3/2", size, np.full(axes, LENGTH))


def design_grid(
    box: Box,
    motion: Motion,
    budget: int,
    kernels: tuple[Kernel, ...],
    sigma: Array,
    rng: np.random.Generator,
    *,
    reference: Array,
    read: Array | None = None,
) -> GridDesign:
    """Choose `budget` further places, where `read` (n, a) are read already.

    motion     of the pose components per strut error, at places
    kernels    (k,) of the strut errors
    sigma      (k,) noise of a reading, SI
    reference  (a,) place whose errors are subtracted from all others, SI

    Raises ValueError for a budget of nothing, or beyond the number of candidates.
    """
    axes = len(box.names)
    count = CANDIDATES[min(axes, len(CANDIDATES)) - 1]
    candidates = grid_nodes(box.lattice([count] * axes))
    if not 1 <= budget <= len(candidates):
        raise ValueError(f"a budget of {budget} is not between 1 and {len(candidates)}")
    earlier = np.zeros((0, axes)) if read is None else read
    places = np.vstack([candidates, earlier, reference[None]])
    modes = [_modes(kernel, box.scaled(places)) for kernel in kernels]
    errors = _error_rows(motion(places), modes)
    blocks = errors / sigma[:, None]
    known = blocks[len(candidates) : -1].reshape(-1, blocks.shape[2])
    prior = np.eye(blocks.shape[2]) + known.T @ known
    blocks = blocks[: len(candidates)]
    relative = errors[: len(candidates)] - errors[-1]
    rows = relative.reshape(-1, blocks.shape[2]) / max(k.size for k in kernels)
    factor = np.linalg.qr(rows, mode="r") / np.sqrt(len(rows))
    choice = choose(
        blocks, budget, rng, criterion=Variance(factor), prior=prior, rounds=ROUNDS
    )
    chosen = blocks[choice.indices].reshape(-1, blocks.shape[2])
    covariance = np.linalg.inv(prior + chosen.T @ chosen)
    variance = np.einsum("ckn,nm,ckm->ck", relative, covariance, relative)
    return GridDesign(
        places=candidates[choice.indices],
        predicted=np.sqrt(variance.mean(axis=0)),
        efficiency=choice.efficiency,
    )


def _modes(kernel: Kernel, scaled: Array) -> Array:
    """Trend and leading modes (n, r) of a component at scaled places (n, a)."""
    values, vectors = np.linalg.eigh(kernel.covariance(scaled, scaled))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    needed = int(np.searchsorted(np.cumsum(values), ENERGY * values.sum())) + 1
    size = min(needed, MODES)
    field = vectors[:, :size] * np.sqrt(values[:size])
    trend = TREND * kernel.size * np.column_stack([np.ones(len(scaled)), scaled])
    return np.hstack([trend, field])


def _error_rows(motion: Array, modes: list[Array]) -> Array:
    """Rows (n, k, sum r) of the pose errors over the coefficients of all struts' modes.

    motion  (n, k, struts)
    modes   of each strut (n, r)
    """
    parts = [motion[:, :, j, None] * m[:, None] for j, m in enumerate(modes)]
    return np.concatenate(parts, axis=2)
