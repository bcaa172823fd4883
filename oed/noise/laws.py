"""Noise laws of readings: their covariance in linear time, whitening, draws.

The error of a reading is, beside what the README has, c . seat: the unknowns that its
run seats anew, with slopes c. Shared are the errors that instrument and study state,
and the course of the session through all runs (`oed.measurement.noise_structure`).
"""

import dataclasses
import functools
import math

import numpy as np
import scipy

from oed.base import Array, Index
from oed.noise.banded import ChainFactor, chain_errors, taken_out
from oed.noise.covariance import FactoredNoise, Noise
from oed.noise.factor import Errors, LinearFactor, WideFactor
from oed.noise.statement import NOTHING_STATED, NoiseStatement
from oed.noise.structure import ReadingStructure

#: least and largest size of an outlier that is drawn, over the noise of single readings
OUTLIER_SIZES = (5.0, 50.0)
BATCH_SIZE = 1_000_000  #: numbers in the largest array of one batch of laws: 8 MB
#: numbers of whitened readings that are worked on together: half of a core's cache
CACHED_NUMBERS = 150_000
#: size of a part of a law, over the stated noise, from which it is described
DESCRIBED_SIZE = 0.2


@dataclasses.dataclass(frozen=True, eq=False)
class Laws:
    """L noise laws, in units of the stated noise."""

    scale: Array  #: (L, G) of each group of readings
    #: (L,) share f of the variance of single readings that is correlated
    correlated: Array
    reach: Array  #: (L,) of that correlation along a run, in readings
    level: Array  #: (L,) standard deviation of a run's level
    seat: Array  #: (L,) standard deviation of a renewed unknown
    #: (L,) factors on those that are stated; ones by default
    stated_level: Array = dataclasses.field(default_factory=lambda: np.ones(0))
    stated_seat: Array = dataclasses.field(default_factory=lambda: np.ones(0))
    #: (L,) standard deviation of the session's course at its end; 0 by default
    course: Array = dataclasses.field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not self.course.size:
            object.__setattr__(self, "course", np.zeros(len(self)))
        for name in ("stated_level", "stated_seat"):
            if not getattr(self, name).size:
                object.__setattr__(self, name, np.ones(len(self)))

    def __len__(self) -> int:
        return len(self.correlated)

    @property
    def sizes(self) -> Array:
        """Sizes (L, 5) of the errors that a run shares, by their kinds."""
        ones = np.ones(len(self))
        kinds = (self.level, ones, self.seat, self.stated_level, self.stated_seat)
        return np.stack(kinds, axis=1)

    def take(self, rows: Index | slice | list[int]) -> "Laws":
        """The laws of these rows."""
        fields = dataclasses.fields(self)
        return Laws(*(getattr(self, field.name)[rows] for field in fields))

    def batches(self, numbers: int) -> "list[Laws]":
        """Laws in parts whose arrays fit into memory: `numbers` of one law."""
        step = max(1, BATCH_SIZE // numbers)
        return [self.take(slice(k, k + step)) for k in range(0, len(self), step)]

    @classmethod
    def stated(
        cls, structure: ReadingStructure, count: int = 1, scale: float = 1.0
    ) -> "Laws":
        """The stated noise, `count` times, single readings with a scale."""
        zero = np.zeros(count)
        statement = structure.statement
        return cls(
            scale=np.full((count, len(structure.names)), scale),
            correlated=zero + statement.correlated_share,
            reach=zero + statement.reach_median,
            level=zero,
            seat=zero,
        )

    def whitening(self, structure: ReadingStructure) -> "Whitening":
        """Readings of a structure under all laws."""
        return Whitening(structure, self)

    def noise(self, structure: ReadingStructure) -> "LawNoise":
        """Noise of readings under the first law, SI."""
        law = self.take([0])
        shared = (structure.columns * law.sizes[0, structure.kinds]) ** 2
        sd = law.scale[0, structure.group] * np.sqrt(1.0 + shared.sum(axis=1))
        (common,) = common_columns(structure, law)
        if common.size:
            sd = np.sqrt(sd**2 + (common**2).sum(axis=1))
        alone = LinearFactor(_reading_errors(structure, law.errors(structure)))
        factor: LinearFactor | WideFactor = alone
        if structure.has_effects:
            factor = alone.widened(structure.restore(structure.effects.T).T)
        return LawNoise(
            structure.unit * sd, factor=factor, structure=structure, law=law
        )

    def factor(self, structure: ReadingStructure) -> LinearFactor:
        """Root of the covariance under the first law, over the stated noise."""
        return LinearFactor(self.errors(structure))

    def errors(self, structure: ReadingStructure, rows: Index | None = None) -> Errors:
        """Errors of the readings, `rows` (k,) of them, under the first law, over the
        stated noise. With a course all are one segment, in which each run has columns
        of its own.
        """
        chain = structure.chain
        order = np.lexsort((structure.position, chain))
        if rows is not None:
            order = order[np.isin(order, rows)]
        ordered, position = chain[order], structure.position[order]
        first = np.diff(ordered, prepend=-1) > 0
        steps = np.diff(position, prepend=0.0)
        correlated = np.full(len(order), self.correlated[0])
        decay = np.exp(-np.where(first, np.inf, steps) / self.reach[0])
        new_run = np.diff(structure.run[ordered], prepend=-1) > 0
        starts = np.flatnonzero(new_run)
        shared = (structure.columns * self.sizes[0, structure.kinds])[order]
        if structure.course.size and self.course[0]:
            course = self.course[0] * structure.course[order]
            shared = np.hstack([_columns_by_run(shared, starts), course])
            starts = starts[:1]
        return Errors(
            order=order,
            starts=starts,
            decay=decay if correlated.any() else np.zeros(len(order)),
            single=1.0 - correlated,
            correlated=correlated,
            shared=shared,
            scale=self.scale[0, structure.group][order],
        )


def _reading_errors(structure: ReadingStructure, errors: Errors) -> Errors:
    """Errors over the stated noise as errors of the readings, SI, channels coupled."""
    order = errors.order
    if structure.decouple is None:
        return dataclasses.replace(errors, scale=errors.scale * structure.unit[order])
    unmix = scipy.sparse.csr_array(structure.decouple[order][:, order])
    return dataclasses.replace(errors, unmix=unmix)


def _columns_by_run(shared: Array, starts: Index) -> Array:
    """Columns (N, K) of errors that a run shares as columns (N, R K) of all readings."""
    count, kinds = shared.shape
    columns, rows = np.zeros((count, len(starts), kinds)), np.arange(count)
    columns[rows, np.searchsorted(starts, rows, side="right") - 1] = shared
    return columns.reshape(count, -1)


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


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LawNoise(FactoredNoise):
    """Noise of N readings under a law, SI."""

    structure: ReadingStructure  #: of the readings
    law: Laws  #: the law, one of some laws

    def split_common(self) -> tuple[Noise, Array]:
        """As in `Noise`: effects and the course apart."""
        structure, law = self.structure, self.law
        (columns,) = common_columns(structure, law)
        if not columns.size:
            return super().split_common()
        alone = dataclasses.replace(law, course=np.zeros(len(law)))
        bare = dataclasses.replace(structure, effects=np.zeros((0, 0)))
        return alone.noise(bare), structure.restore(columns.T).T

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        laws = self.law.take([0] * int(np.prod(shape[:-1])))
        errors = laws.whitening(self.structure).draw(rng)
        return self.structure.restore(errors).reshape(shape)


@dataclasses.dataclass(frozen=True, eq=False)
class NoiseLaw:
    """A noise law, in units of the stated noise."""

    law: Laws  #: one of some laws
    level: float = 1.0  #: factor on everything; 1 where it is marginalised elsewhere
    #: degrees of freedom of the readings' Student t, inf where they are normal
    student_dof: float = np.inf
    #: share of readings that are far off, where the others are normal
    outlier_share: float = 0.0

    def errors(self, structure: ReadingStructure, rows: Index | None = None) -> Errors:
        """What the covariance of the readings, or of `rows`, consists of."""
        errors = _reading_errors(structure, self.law.errors(structure, rows))
        return dataclasses.replace(errors, scale=self.level * errors.scale)

    def factor(
        self, structure: ReadingStructure, rows: Index | None = None
    ) -> LinearFactor:
        """Root of the covariance of all readings, or of the readings `rows`."""
        return LinearFactor(self.errors(structure, rows))

    def describe(
        self, longest: float = np.inf, unit: str = "the stated noise"
    ) -> tuple[str, ...]:
        """The law in sentences, for a longest run of so many readings.

        unit  what its sizes are multiples of
        """
        sentences = [f"single readings scatter by {self.level:.2g} times {unit}"]
        run, seat = (float(sizes[0]) for sizes in (self.law.level, self.law.seat))
        correlated = float(np.sqrt(self.law.correlated[0]))
        reach = float(self.law.reach[0])
        if run > DESCRIBED_SIZE:
            sentences.append(f"runs differ by {self.level * run:.2g} times {unit}")
        if seat > DESCRIBED_SIZE:
            sentences.append(
                "what a run seats anew, such as a cup on its magnet, repeats to"
                f" {self.level * seat:.2g} times {unit}"
            )
        if correlated > DESCRIBED_SIZE:
            sentences.append(
                f"noise of {self.level * correlated:.2g} times {unit} is"
                f" correlated {reach_phrase(reach, longest)}"
            )
        if np.isfinite(self.student_dof):
            sentences.append(
                f"readings far off are frequent (Student t with {self.student_dof:.2g}"
                " degrees of freedom)"
            )
        if self.outlier_share > 0.0:
            sentences.append(
                f"about {100.0 * self.outlier_share:.2g} % of the readings are far off"
            )
        return tuple(sentences)


def reach_phrase(reach: float, longest: float) -> str:
    """How far an error is correlated along a run, in readings, as far as seen."""
    if reach > 0.5 * longest:
        return f"over whole runs of up to {longest:.0f} readings"
    if reach < 1.5:
        return "to the next reading"
    return f"over about {reach:.0f} readings"


class Whitening:
    """Readings of a structure under L laws.

    White and correlated error have the banded root of `oed.noise.banded`, which a share and a
    reach of the correlated part make: laws that differ in no more than scales and sizes
    have it in common. Values are (P, C, T, m), for P pairs of share and reach, chain by
    chain. Where a chain has no reading they are 0, of variance 1.
    """

    def __init__(self, structure: ReadingStructure, laws: Laws) -> None:
        self.structure, self.laws = structure, laws

    @functools.cached_property
    def log_determinant(self) -> Array:
        """Log determinants (L,) of the covariances, in units of the stated noise."""
        return self._products(np.zeros((len(self.structure), 0)))[1]

    def gram(self, values: Array) -> Array:
        """Products Y^T C^-1 Y (L, m, m), for standardised Y (N, m) or (L, N, m)."""
        # the determinant is mostly asked for next
        gram, self.__dict__["log_determinant"] = self._products(values)
        return gram

    def _products(self, values: Array) -> tuple[Array, Array]:
        """Products (L, m, m), by Woodbury, and log determinants (L,) of covariances."""
        gram, log_determinant = self._products_of_noise(values)
        count = values.shape[-1]
        if gram.shape[-1] == count:
            return gram, log_determinant
        shared = gram[:, None, count:]
        amounts = np.ones((len(gram), shared.shape[2]))
        removed, more = taken_out(shared[..., count:], shared[..., :count], amounts)
        return gram[:, :count, :count] - removed, log_determinant + more

    def _products_of_noise(self, values: Array) -> tuple[Array, Array]:
        """The same without what all readings share, of whose columns there are products."""
        laws, structure = self.laws, self.structure
        pairs = np.stack([laws.correlated, laws.reach], axis=1)
        number = np.arange(len(laws))
        if values.ndim == 2:
            values = values[None]
            distinct, of_law = np.unique(pairs, axis=0, return_inverse=True)
            if len(distinct) < len(laws):
                pairs, number = distinct, of_law
        grid = self._chain_grid(self._with_common(values))
        shared = self._chain_grid(structure.columns[None])
        count = grid.shape[-1]
        size = (count + shared.shape[-1]) * math.prod(structure.shape) + count**2
        step = max(1, CACHED_NUMBERS // size)
        of_pair = np.bincount(number, minlength=len(pairs))
        order = np.argsort(number, kind="stable")
        members = np.split(order, np.cumsum(of_pair)[:-1])
        alone = np.flatnonzero(of_pair == 1)
        batches = [alone[first : first + step] for first in range(0, len(alone), step)]
        # a pair's laws have its products in common
        batches += list(np.flatnonzero(of_pair > 1)[:, None])
        gram, log_determinant = np.empty((len(laws), count, count)), np.empty(len(laws))
        for some in batches:
            rows = np.concatenate([members[k] for k in some])
            part = grid if len(grid) == 1 else grid[some]
            gram[rows], log_determinant[rows] = self._pair_products(
                pairs[some], laws.take(rows), part, shared
            )
        return gram, log_determinant

    def _with_common(self, values: Array) -> Array:
        """Values (L or 1, N, m), then the columns that all readings share."""
        structure = self.structure
        wide = [structure.effects] if structure.has_effects else []
        wide += [structure.course] if self._has_course else []
        if not wide:
            return values
        parts = [np.broadcast_to(w, (len(values), *w.shape)) for w in wide]
        return np.concatenate([values, *parts], axis=2)

    @property
    def _has_course(self) -> bool:
        return bool(self.structure.course.size and self.laws.course.any())

    def _pair_products(
        self, pairs: Array, laws: Laws, grid: Array, shared: Array
    ) -> tuple[Array, Array]:
        """The same of one law for each of P pairs (P, 2), or of all laws of one pair.

        Values are (1 or P, C, T, m), columns that a run shares (1, C, T, K).
        """
        structure, count = self.structure, grid.shape[-1]
        shape = (len(pairs), *structure.shape)
        both = [np.broadcast_to(p, (*shape, p.shape[-1])) for p in (grid, shared)]
        log_variances, is_correlated = np.zeros(len(pairs)), bool(pairs[:, 0].any())
        if is_correlated:
            factor = self._factor(pairs)
            log_variances = factor.log_variances.reshape(len(pairs), -1).sum(axis=1)
            chains = [v.reshape(math.prod(v.shape[:2]), *v.shape[2:]) for v in both]
            both = [
                factor.whiten_chains(c).reshape(*shape, c.shape[-1]) for c in chains
            ]
        white, columns = both
        factors = self._factors(laws, count)[:, structure.group_of_chain]
        transposed = columns.swapaxes(2, 3)
        if len(pairs) == len(laws):
            output = white if is_correlated else None
            white = np.multiply(white, factors[:, :, None], out=output)
            rows = white.reshape(len(laws), -1, count)
            gram = rows.swapaxes(1, 2) @ rows
            across = transposed @ white
        else:
            gram = self._weighted_sums(laws, white[0])
            across = (transposed @ white) * factors[:, :, None]
        # raised by what rounds off the sums: what is left of them stays positive definite
        # where shared errors take nearly all, under noise far below the stated one
        diagonal = np.einsum("lmm->lm", gram)
        diagonal *= 1.0 + np.sqrt(math.prod(structure.shape)) * np.finfo(float).eps
        inner = self._run_sums(transposed @ columns)
        amounts = laws.sizes[:, structure.kinds]
        removed, more = taken_out(inner, self._run_sums(across), amounts)
        counts = np.bincount(structure.group, minlength=laws.scale.shape[1])
        log_scales = np.log(laws.scale) @ counts
        gram -= removed
        return gram, log_variances + 2.0 * log_scales + more

    def _factors(self, laws: Laws, count: int) -> Array:
        """Factors (l, G, m) of laws on m values, the session's course the last of them."""
        factors = np.repeat(1.0 / laws.scale[:, :, None], count, axis=2)
        if self._has_course:
            factors[..., -self.structure.course.shape[1] :] = laws.course[:, None, None]
        return factors

    def _weighted_sums(self, laws: Laws, white: Array) -> Array:
        """Products (l, m, m) of white values (C, T, m) under laws of one pair."""
        rows = [white[chains] for chains in self.structure.chains_of_group]
        rows = [part.reshape(-1, part.shape[-1]) for part in rows]
        grams = np.array([part.T @ part for part in rows])
        inverse = 1.0 / laws.scale
        sums = np.tensordot(inverse**2, grams, 1)
        if self._has_course:
            start = grams.shape[-1] - self.structure.course.shape[1]
            course = laws.course[:, None, None]
            mixed = course * np.tensordot(inverse, grams[:, :start, start:], 1)
            sums[:, :start, start:] = mixed
            sums[:, start:, :start] = mixed.swapaxes(1, 2)
            sums[:, start:, start:] = course**2 * grams[:, start:, start:].sum(axis=0)
        return sums

    def _factor(self, pairs: Array) -> ChainFactor:
        """White and correlated errors (P C T,)."""
        correlated, reach = pairs.T[:, :, None, None]
        decay = np.exp(-self.structure.steps / reach)
        single = np.broadcast_to(1.0 - correlated, decay.shape)
        fresh = correlated * (1.0 - decay**2)
        return ChainFactor(decay.ravel(), single.ravel(), fresh.ravel())

    def _chain_grid(self, values: Array) -> Array:
        """Values (L or 1, N, m) by chains (L or 1, C, T, m)."""
        reading, absent = self.structure.reading_of_slot
        grid = np.take(values, reading, axis=1)
        grid[:, absent] = 0.0
        return grid

    def _run_sums(self, of_chains: Array) -> Array:
        """Sums (L, R, ...) over each run of what its chains (L, C, ...) have."""
        first = self.structure.first_chains
        laws, chains, *rest = of_chains.shape
        of_run = chains // len(first)
        if np.array_equal(first, np.arange(0, chains, of_run)):
            by_run = of_chains.reshape(laws, len(first), of_run, *rest)
            return np.asarray(by_run.sum(axis=2))  # a tenth of the time of `reduceat`
        return np.asarray(np.add.reduceat(of_chains, first, axis=1))

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
                   as informative as errors of such tails (`oed.noise_law.outliers`)
        """
        count = len(self.laws)
        chains, length = self.structure.shape
        white = rng.standard_normal((2, count, chains, length))
        correlated = self._correlated_errors(white[0])
        share = self.laws.correlated[:, None, None]
        alone = _heavy_tailed(white[1], tails, rng)
        if estimated and tails.student_dof is not None:
            alone *= _student_over_pseudo(tails.student_dof)
        single = np.sqrt(1.0 - share) * alone + np.sqrt(share) * correlated
        runs = int(self.structure.run[-1]) + 1
        amounts = rng.standard_normal((count, runs, len(self.structure.kinds)))
        amounts *= self.laws.sizes[:, None, self.structure.kinds]
        of_reading = amounts[:, self.structure.run[self.structure.chain]]
        common = np.einsum("lnk,nk->ln", of_reading, self.structure.columns)
        scale = self.laws.scale[:, self.structure.group]
        errors = scale * (single[:, *self.structure.slot] + common)
        wide = common_columns(self.structure, self.laws)
        if wide.shape[-1]:
            amounts = rng.standard_normal((count, wide.shape[-1]))
            errors += np.einsum(
                "lk,lnk->ln", amounts, np.broadcast_to(wide, (count, *wide.shape[1:]))
            )
        return np.asarray(errors)

    def _correlated_errors(self, white: Array) -> Array:
        """Errors (L, C, T) of unit size that are correlated along a run, of white ones."""
        decay = np.exp(-self.structure.steps / self.laws.reach[:, None, None])
        fresh = np.sqrt(1.0 - decay**2) * white
        return chain_errors(decay.ravel(), fresh.ravel()).reshape(white.shape)


def _student_over_pseudo(dof: float) -> float:
    """Sd of a Student t over its pseudo-value's, the inverse of Fisher information."""
    return float(np.sqrt(dof / (dof - 2.0) * (dof + 1.0) / (dof + 3.0)))


def _heavy_tailed(
    errors: Array, tails: NoiseStatement, rng: np.random.Generator
) -> Array:
    """Normal errors of unit variance with stated tails, those far off from 5 to 50."""
    if tails.student_dof is not None:
        dof = tails.student_dof
        chi2 = rng.chisquare(dof, errors.shape)
        return errors * np.sqrt((dof - 2.0) / chi2)
    if tails.outlier_share:
        smallest, largest = np.log(OUTLIER_SIZES)
        size = np.exp(rng.uniform(smallest, largest, errors.shape))
        size *= rng.choice([-1.0, 1.0], errors.shape)
        far = rng.uniform(size=errors.shape) < tails.outlier_share
        return errors + np.where(far, size, 0.0)
    return errors
