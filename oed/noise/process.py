"""The noise of readings as a process: laws, their covariance in linear time, draws.

In units of the stated noise, a chain of readings (one channel of a run) has the error

    e_k = s [ sqrt(1 - f) white_k + sqrt(f) carried_k + a level + c . seat + shared
              + d . course ]

with white_k and level independent standard normal, carried_k an Ornstein-Uhlenbeck
process with correlation exp(-|k - l| / reach), s the channel's own, seat the set-up's unknowns that the run
seated anew, with slopes c, and shared the errors that instrument and study state. The
course of the session goes through all runs (`oed.noise.course`).

White and carried error have a banded root (`oed.noise.banded`); what a run shares is a
matrix of a few columns, taken out by the Woodbury identity (`oed.noise.shared`). Both are
linear in the number of readings. A session's course and effects that the model lacks are
columns that all readings share, V, with C + V V^T for C.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from oed.base.arrays import Array
from oed.noise.banded import ChainFactor, along_chains
from oed.noise.shared import taken_out
from oed.noise.statement import NOTHING_STATED, NoiseStatement
from oed.noise.structure import ReadingStructure

#: least and largest size of an error that is far off, where one is drawn
FAR = (5.0, 50.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Laws:
    """L noise laws, in units of the stated noise.

    scale    (L, G) of each group of readings
    carried  (L,) share f of the variance of single readings that is carried along
    reach    (L,) of what is carried along, in readings
    level    (L,) standard deviation of a run's level
    seat     (L,) standard deviation of a renewed unknown
    stated_level, stated_seat  (L,) factors on those that are stated; ones by default
    course   (L,) standard deviation of the session's course at its end; 0 by default
    """

    scale: Array
    carried: Array
    reach: Array
    level: Array
    seat: Array
    stated_level: Array = dataclasses.field(default_factory=lambda: np.ones(0))
    stated_seat: Array = dataclasses.field(default_factory=lambda: np.ones(0))
    course: Array = dataclasses.field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not self.course.size:
            object.__setattr__(self, "course", np.zeros(len(self)))
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


def stated_laws(
    structure: ReadingStructure, count: int = 1, scale: float = 1.0
) -> Laws:
    """The stated noise, `count` times, single readings with a scale."""
    zero, statement = np.zeros(count), structure.statement
    return Laws(
        scale=np.full((count, len(structure.names)), scale),
        carried=zero + statement.carried_share,
        reach=zero + statement.reach_median,
        level=zero,
        seat=zero,
    )


class Whitening:
    """Readings of a structure under L laws, laws one after the other in one vector.

    White and carried error have the banded root of `oed.noise.banded`. Values are (m, L,
    C, T), chain by chain. Where a chain has no reading they are 0, of variance 1.
    """

    def __init__(self, structure: ReadingStructure, laws: Laws) -> None:
        self.structure, self.laws = structure, laws
        self._chain_scale = laws.scale[:, structure.group_of_chain]
        self._share = laws.carried[:, None, None]

    @functools.cached_property
    def _decay(self) -> Array:
        """Decays (L, C, T) of what is carried from the reading before."""
        return np.exp(-self.structure.steps / self.laws.reach[:, None, None])

    @functools.cached_property
    def _factor(self) -> ChainFactor | None:
        """White and carried errors (L C T,); None where nothing is carried."""
        if not self.laws.carried.any():
            return None
        decay, carried = self._decay, self._share
        single = np.broadcast_to(1.0 - carried, decay.shape)
        fresh = carried * (1.0 - decay**2)
        return ChainFactor(decay.ravel(), single.ravel(), fresh.ravel())

    def _halves(self, grid: Array) -> tuple[Array, Array]:
        """Halves (m, L, C, T) of values, whose products are those of the precision."""
        if self._factor is None:
            return grid, grid
        flat = grid.reshape(len(grid), math.prod(grid.shape[1:]))
        differences, solved = self._factor.halves(flat.T)
        return differences.T.reshape(grid.shape), solved.T.reshape(grid.shape)

    def _on_chains(self, values: Array) -> Array:
        """Values (L or 1, N, m) by chains (m, L or 1, C, T)."""
        reading, absent = self.structure.reading_of_slot
        grid = np.take(values.transpose(2, 0, 1), reading, axis=2)
        if absent.any():
            grid[:, :, absent] = 0.0
        return grid

    @functools.cached_property
    def _columns(self) -> tuple[Array, Array]:
        """Half (K, L, C, T) of the errors that a run shares, of unit size, and their
        products (L, R, K, K).
        """
        columns = self._on_chains(self.structure.columns[None])
        shape = (len(columns), len(self.laws), *columns.shape[2:])
        differences, solved = self._halves(np.broadcast_to(columns, shape))
        return solved, self._run_products(solved, differences)

    def _run_products(self, columns: Array, values: Array) -> Array:
        """Sums (L, R, K, m) over each run of columns (K, L, C, T) times values (m, ...)."""
        by_chain = columns.transpose(1, 2, 0, 3) @ values.transpose(1, 2, 3, 0)
        first = self.structure.first_chains
        if len(first) == by_chain.shape[1]:
            return np.asarray(by_chain)
        return np.add.reduceat(by_chain, first, axis=1)

    @functools.cached_property
    def log_determinant(self) -> Array:
        """Log determinants (L,) of the covariances, in units of the stated noise."""
        counts = np.bincount(self.structure.group, minlength=self.laws.scale.shape[1])
        alone = 2.0 * np.log(self.laws.scale) @ counts
        if self._factor is not None:
            log_variances = self._factor.log_variances.reshape(len(alone), -1)
            alone += log_variances.sum(axis=1)
        inner = self._columns[1]
        alone += taken_out(inner, inner[..., :0], self._amounts)[1]
        if not self._wide.shape[-1]:
            return alone
        diagonals = np.diagonal(self._root_of_wide, axis1=-2, axis2=-1)
        return np.asarray(alone + 2.0 * np.log(diagonals).sum(axis=1))

    @functools.cached_property
    def _wide(self) -> Array:
        """Columns V (L or 1, N, k) that all readings share."""
        return common_columns(self.structure, self.laws)

    @functools.cached_property
    def _root_of_wide(self) -> Array:
        """Cholesky factor of 1 + V^T C^-1 V (L, k, k)."""
        return _root_above_one(self._gram_of_noise(self._wide))

    @property
    def _amounts(self) -> Array:
        """Sizes (L, K) of the errors that a run shares."""
        return self.laws.sizes[:, self.structure.kinds]

    def gram(self, values: Array) -> Array:
        """Products Y^T C^-1 Y (L, m, m), for standardised Y (N, m) or (L, N, m).

        What all readings share is taken out by the Woodbury identity.
        """
        wide, count = self._wide, values.shape[-1]
        if not wide.shape[-1]:
            return self._gram_of_noise(values)
        batch = values if values.ndim == 3 else values[None]
        laws = max(len(batch), len(wide))
        parts = [np.broadcast_to(p, (laws, *p.shape[1:])) for p in (batch, wide)]
        whole = self._gram_of_noise(np.concatenate(parts, axis=-1))
        across = whole[:, count:, :count]
        # kept for the determinant, which is mostly asked for next
        root = _root_above_one(whole[:, count:, count:])
        self.__dict__["_root_of_wide"] = root
        half = np.linalg.solve(root, across)
        return whole[:, :count, :count] - half.swapaxes(1, 2) @ half

    def _gram_of_noise(self, values: Array) -> Array:
        """The same without what all readings share."""
        batch = values if values.ndim == 3 else values[None]
        scaled = self._on_chains(batch) / self._chain_scale[:, :, None]
        differences, solved = self._halves(scaled)
        columns, count = scaled.shape[:2]
        rows = differences.reshape(columns, count, -1).swapaxes(0, 1)
        whole = rows @ solved.reshape(columns, count, -1).transpose(1, 2, 0)
        # raised by what rounds off the sums: what is left of them stays positive definite
        # where shared errors take nearly all, under noise far below the stated one
        diagonal = np.einsum("lmm->lm", whole)
        diagonal *= 1.0 + np.sqrt(rows.shape[-1]) * np.finfo(float).eps
        half, inner = self._columns
        products = self._run_products(half, differences)
        return whole - taken_out(inner, products, self._amounts)[0]

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
        share = self._share
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
        errors = scale * (single[:, *self.structure.slot] + common)
        wide = self._wide
        if wide.shape[-1]:
            amounts = rng.standard_normal((count, wide.shape[-1]))
            errors += np.einsum(
                "lk,lnk->ln", amounts, np.broadcast_to(wide, (count, *wide.shape[1:]))
            )
        return np.asarray(errors)

    def _carried_along(self, white: Array) -> Array:
        """Errors (L, C, T) of unit size that are carried along, of white ones."""
        decay = self._decay
        fresh = np.sqrt(1.0 - decay**2) * white
        return along_chains(decay.ravel(), fresh.ravel()).reshape(white.shape)


def _root_above_one(gram: Array) -> Array:
    """Cholesky factor of 1 + G (L, k, k)."""
    return np.asarray(np.linalg.cholesky(gram + np.eye(gram.shape[-1])))


def common_columns(structure: ReadingStructure, laws: Laws) -> Array:
    """Columns (L or 1, N, k) that all readings share: effects, and the course."""
    effects = structure.effects[None]
    if not (structure.course.size and laws.course.any()):
        return effects
    size = (laws.course[:, None] * laws.scale)[:, structure.group]
    course = structure.course * size[..., None]
    if not structure.has_effects:
        return course
    repeated = np.broadcast_to(effects, (len(course), *effects.shape[1:]))
    return np.concatenate([repeated, course], axis=-1)


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
        return errors * np.sqrt((dof - 2.0) / chi2)
    if tails.outlier_share:
        size = np.exp(rng.uniform(np.log(FAR[0]), np.log(FAR[1]), errors.shape))
        size *= rng.choice([-1.0, 1.0], errors.shape)
        far = rng.uniform(size=errors.shape) < tails.outlier_share
        return errors + np.where(far, size, 0.0)
    return errors
