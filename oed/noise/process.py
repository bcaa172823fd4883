"""The noise of readings as a process: laws, their covariance in linear time, draws.

In units of the stated noise, a chain of readings (one channel of a run) has the error

    e_k = s [ sqrt(1 - f) white_k + sqrt(f) carried_k + a level + c . seat + shared ]

with white_k and level independent standard normal, carried_k an Ornstein-Uhlenbeck
process with correlation exp(-|k - l| / reach), seat the set-up's unknowns that the run
seated anew, with slopes c, and shared the errors that instrument and study state.

White and carried error are whitened by a recursion along the chains, block by block
(`oed.noise.recursions`); what a run shares is a matrix of a few columns, taken out by the
Woodbury identity. Both are linear in the number of readings.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator

import numpy as np

from oed.base.arrays import Array
from oed.noise.recursions import (
    block_shape,
    carried_variances,
    in_blocks,
    next_steps,
    out_of_blocks,
    states_at_starts,
)
from oed.noise.statement import NOTHING_STATED, NoiseStatement
from oed.noise.structure import ReadingStructure

#: least and largest size of an error that is far off, where one is drawn
FAR = (5.0, 50.0)
#: numbers in a step of what is filtered together
AT_ONCE = 6000


@dataclasses.dataclass(frozen=True, eq=False)
class Laws:
    """L noise laws, in units of the stated noise.

    scale    (L, G) of each group of readings
    carried  (L,) share f of the variance of single readings that is carried along
    reach    (L,) of what is carried along, in readings
    level    (L,) standard deviation of a run's level
    seat     (L,) standard deviation of a renewed unknown
    stated_level, stated_seat  (L,) factors on those that are stated; ones by default
    """

    scale: Array
    carried: Array
    reach: Array
    level: Array
    seat: Array
    stated_level: Array = dataclasses.field(default_factory=lambda: np.ones(0))
    stated_seat: Array = dataclasses.field(default_factory=lambda: np.ones(0))

    def __post_init__(self) -> None:
        for name in ("stated_level", "stated_seat"):
            if not getattr(self, name).size:
                object.__setattr__(self, name, np.ones(len(self)))

    def __len__(self) -> int:
        return len(self.carried)

    @property
    def sizes(self) -> Array:
        """Sizes (L, 5) of the errors that a run shares, by their kinds."""
        known = np.ones(len(self))
        kinds = (self.level, known, self.seat, self.stated_level, self.stated_seat)
        return np.stack(kinds, axis=1)

    def take(self, rows: Array | slice | list[int]) -> Laws:
        """The laws of these rows."""
        fields = dataclasses.fields(self)
        return Laws(*(getattr(self, field.name)[rows] for field in fields))


def stated_laws(structure: ReadingStructure, count: int = 1) -> Laws:
    """The stated noise, `count` times."""
    zero, statement = np.zeros(count), structure.statement
    return Laws(
        scale=np.ones((count, len(structure.names))),
        carried=zero + statement.carried_share,
        reach=zero + statement.reach_median,
        level=zero,
        seat=zero,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _FilterSteps:
    """What a filter does at each reading, in blocks (S, L, C, B).

    The prediction s of the next reading is pole s + inflow y, y the reading; weight is 1
    over the standard deviation of y - s.
    """

    pole: Array
    inflow: Array
    weight: Array


class Whitening:
    """Readings of a structure under L laws.

    White and carried error have the banded root of `oed.noise.banded`: its rows are the
    filter's innovations over their standard deviations. Filtered values are
    (m, L, C, T'), T' = S B: a chain's blocks side by side, and steps with no reading 0.
    """

    def __init__(self, structure: ReadingStructure, laws: Laws) -> None:
        self.structure, self.laws = structure, laws
        self._chain_scale = laws.scale[:, structure.group_of_chain]
        self._is_white = not laws.carried.any()

    @functools.cached_property
    def _decay(self) -> Array:
        """Decays (S, L, P, B) from the reading before, of patterns of steps."""
        steps = in_blocks(self.structure.step_patterns[0], np.inf)
        return np.asarray(np.exp(-steps[:, None] / self.laws.reach[:, None, None]))

    @functools.cached_property
    def _variance(self) -> tuple[Array, Array]:
        """Variances of what is carried, and of innovations, (S, L, P, B) of patterns."""
        carried = carried_variances(self._decay, self.laws.carried)
        return carried, carried + (1.0 - self.laws.carried)[:, None, None]

    @functools.cached_property
    def _filter_steps(self) -> _FilterSteps:
        pattern = self.structure.step_patterns[1]
        carried, total = self._variance
        gain, following = carried / total, next_steps(self._decay)
        by_pattern = (following * (1.0 - gain), following * gain, 1.0 / np.sqrt(total))
        return _FilterSteps(*(values[:, :, pattern] for values in by_pattern))

    def _filter(self, values: Array, scale: Array | None = None) -> Array:
        """Innovations (m, L, C, T') of values (L or 1, N, m), over a scale (L, C)."""
        structure = self.structure
        reading, absent = structure.reading_of_step
        columns = np.ascontiguousarray(values.transpose(2, 0, 1))
        blocks = np.take(columns, reading, axis=2)
        if absent.any():
            blocks[:, :, absent] = 0.0
        length, chains, count = reading.shape
        out = np.empty((len(blocks), len(self.laws), chains, length, count))
        for some, laws in self._batches(len(blocks)):
            batch = blocks[some] if len(values) == 1 else blocks[some, laws]
            self._innovate(batch, laws, out[some, laws])
        if scale is not None:
            out /= scale[:, :, None, None]
        return out.reshape(*out.shape[:3], length * count)

    def _innovate(self, blocks: Array, laws: slice, target: Array) -> None:
        """Innovations of values (m, L or 1, S, C, B) of some laws, into (m, L, C, S, B)."""
        if self._is_white:
            target[...] = np.swapaxes(blocks, 2, 3)
            return
        steps = self._filter_steps
        pole, inflow = steps.pole[:, laws], steps.inflow[:, laws]
        values = np.moveaxis(blocks, 2, 0)
        drive = inflow[:, None] * values
        state = states_at_starts(pole[:, None], drive)
        difference = np.empty_like(state)
        for k in range(len(values)):
            np.subtract(values[k], state, out=difference)
            np.multiply(difference, steps.weight[k, laws], out=target[:, :, :, k])
            state *= pole[k]
            state += drive[k]

    def _batches(self, columns: int) -> Iterator[tuple[slice, slice]]:
        """Columns and laws that are filtered together: a step of theirs fits into a cache."""
        chains, steps = self.structure.shape
        at_once = max(AT_ONCE // (chains * block_shape(steps)[1]), 1)
        width = max(min(at_once, columns), 1)
        count = max(at_once // width, 1)
        for first in range(0, len(self.laws), count):
            for column in range(0, columns, width):
                yield slice(column, column + width), slice(first, first + count)

    @functools.cached_property
    def _columns(self) -> Array:
        """Filtered errors that a run shares (K, L, C, T')."""
        amounts = self.laws.sizes[:, self.structure.kinds]
        filtered = self._filter(self.structure.columns[None])
        filtered *= amounts.T[:, :, None, None]
        return filtered

    @functools.cached_property
    def _spectrum(self) -> tuple[Array, Array]:
        """Eigenvalues and vectors of each run's shared errors (L, R, K), (L, R, K, K)."""
        values, vectors = np.linalg.eigh(self._run_products(self._columns))
        return np.maximum(values, 0.0), vectors

    def _run_products(self, values: Array) -> Array:
        """Sums (L, R, K, m) over each run of shared errors times values (m, L, C, T')."""
        by_chain = self._columns.transpose(1, 2, 0, 3) @ values.transpose(1, 2, 3, 0)
        first = self.structure.first_chains
        if len(first) == by_chain.shape[1]:
            return np.asarray(by_chain)
        return np.add.reduceat(by_chain, first, axis=1)

    @functools.cached_property
    def log_determinant(self) -> Array:
        """Log determinants (L,) of the covariances, in units of the stated noise."""
        counts = self.structure.present.sum(axis=1)
        shared = np.log1p(self._spectrum[0]).sum(axis=(1, 2))
        shared += 2.0 * np.log(self._chain_scale) @ counts
        if self._is_white:
            return np.asarray(shared)
        present = in_blocks(self.structure.present_of_pattern)
        alone = np.einsum("slpb,spb->l", np.log(self._variance[1]), present)
        return np.asarray(shared + alone)

    def gram(self, values: Array) -> Array:
        """Products Y^T C^-1 Y (L, m, m), for standardised Y (N, m) or (L, N, m)."""
        batch = values if values.ndim == 3 else values[None]
        filtered = self._filter(batch, self._chain_scale)
        columns, count, chains, steps = filtered.shape
        flat = filtered.reshape(columns, count, chains * steps).swapaxes(0, 1)
        whole = flat @ np.swapaxes(flat, 1, 2)
        sizes, vectors = self._spectrum
        projected = np.swapaxes(vectors, 2, 3) @ self._run_products(filtered)
        share = projected / (1.0 + sizes[..., None])
        removed = np.einsum("lrkm,lrkn->lmn", projected, share, optimize=True)
        return np.asarray(whole - removed)

    def whiten(self, values: Array) -> Array:
        """W Y (L, N, m) with W C W^T = 1, for standardised Y (N, m) or (L, N, m)."""
        batch = values if values.ndim == 3 else values[None]
        filtered = self._filter(batch, self._chain_scale)
        sizes, vectors = self._spectrum
        root = 1.0 / np.sqrt(1.0 + sizes) - 1.0
        factor = np.where(sizes > 1e-12, root / np.maximum(sizes, 1e-300), -0.5)
        projected = np.swapaxes(vectors, 2, 3) @ self._run_products(filtered)
        change = vectors @ (factor[..., None] * projected)
        of_chain = np.swapaxes(change[:, self.structure.run], 2, 3)
        common = of_chain @ self._columns.transpose(1, 2, 0, 3)
        filtered += common.transpose(2, 0, 1, 3)
        whitened = filtered[:, :, *self.structure.step_of_reading]
        return np.ascontiguousarray(whitened.transpose(1, 2, 0))

    def draw(
        self,
        rng: np.random.Generator,
        tails: NoiseStatement = NOTHING_STATED,
        *,
        estimated: bool = False,
    ) -> Array:
        """One draw of the errors (L, N) for each law, in units of the stated noise.

        tails      of single readings; normal by default
        estimated  whether the laws are estimates: these rest on pseudo-values, which are
                   as informative as errors of such tails (`oed.noise.outliers`)
        """
        count, (chains, length) = len(self.laws), self.structure.shape
        white = rng.standard_normal((2, count, chains, length))
        carried = self._carried_along(white[0])
        share = self.laws.carried[:, None, None]
        alone = _with_tails(white[1], tails, rng)
        if estimated and tails.student_dof is not None:
            alone *= _student_over_pseudo(tails.student_dof)
        single = np.sqrt(1.0 - share) * alone + np.sqrt(share) * carried
        runs = int(self.structure.run[-1]) + 1
        amounts = rng.standard_normal((count, runs, len(self.structure.kinds)))
        amounts *= self.laws.sizes[:, None, self.structure.kinds]
        of_reading = amounts[:, self.structure.run[self.structure.chain]]
        common = np.einsum("lnk,nk->ln", of_reading, self.structure.columns)
        scale = self.laws.scale[:, self.structure.group]
        return np.asarray(scale * (single[:, *self.structure.slot] + common))

    def _carried_along(self, white: Array) -> Array:
        """Errors (L, C, T) of unit size that are carried along, of white ones."""
        carried = np.empty_like(white)
        steps = in_blocks(self.structure.steps, np.inf)[:, None]
        for _, laws in self._batches(1):
            decay = np.exp(-steps / self.laws.reach[laws, None, None])
            errors = np.sqrt(1.0 - decay**2) * in_blocks(white[laws])
            state = states_at_starts(decay, errors)
            for k in range(len(errors)):
                state = decay[k] * state + errors[k]
                errors[k] = state
            carried[laws] = out_of_blocks(errors, white.shape[2])
        return carried


def _student_over_pseudo(dof: float) -> float:
    """Standard deviation of a Student t error over that of its pseudo-value.

    Of unit scale they are dof / (dof - 2) and the inverse of the Fisher information,
    (dof + 3) / (dof + 1), in squares.
    """
    return float(np.sqrt(dof / (dof - 2.0) * (dof + 1.0) / (dof + 3.0)))


def _with_tails(
    errors: Array, tails: NoiseStatement, rng: np.random.Generator
) -> Array:
    """Independent normal errors of unit variance with the tails that are stated.

    Student t keep the variance. Errors far off come on top, from 5 to 50.
    """
    if tails.student_dof is not None:
        dof = tails.student_dof
        chi2 = rng.chisquare(dof, errors.shape)
        return np.asarray(errors * np.sqrt((dof - 2.0) / chi2))
    if tails.outlier_share:
        size = np.exp(rng.uniform(np.log(FAR[0]), np.log(FAR[1]), errors.shape))
        size *= rng.choice([-1.0, 1.0], errors.shape)
        far = rng.uniform(size=errors.shape) < tails.outlier_share
        return errors + np.where(far, size, 0.0)
    return errors
