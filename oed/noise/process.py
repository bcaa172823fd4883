"""The noise of readings as a process: laws, their covariance in linear time, draws.

In units of the stated noise, a chain of readings (one channel of a run) has the error

    e_k = s [ sqrt(1 - f) white_k + sqrt(f) carried_k + a level + c . seat + shared ]

with white_k and level independent standard normal, carried_k an Ornstein-Uhlenbeck
process with correlation exp(-|k - l| / reach), seat the set-up's unknowns that the run
seated anew, with slopes c, and shared the errors that instrument and study state.

White and carried error are whitened by a Kalman filter along the chains; what a run
shares is a matrix of a few columns, taken out by the Woodbury identity. Both are linear
in the number of readings.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from oed.arrays import Array
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


class Whitening:
    """Readings of a structure under L laws."""

    def __init__(self, structure: ReadingStructure, laws: Laws) -> None:
        self.structure, self.laws = structure, laws
        self._decay = np.exp(-structure.steps / laws.reach[:, None, None])
        self._gain, self._sd = self._kalman_gains()
        self._scale = laws.scale[:, structure.group]

    def _kalman_gains(self) -> tuple[Array, Array]:
        """Gains and standard deviations of the innovations (L, C, T)."""
        carried = self.laws.carried[:, None]
        gain, variance = np.empty_like(self._decay), np.empty_like(self._decay)
        unknown = np.zeros(self._decay.shape[:2])
        for t in range(self._decay.shape[2]):
            decay = self._decay[:, :, t] ** 2
            unknown = carried * (1.0 - decay) + decay * unknown
            variance[:, :, t] = unknown + 1.0 - carried
            gain[:, :, t] = unknown / variance[:, :, t]
            unknown = unknown * (1.0 - gain[:, :, t])
        return gain, np.sqrt(variance)

    def _filter(self, values: Array) -> Array:
        """Innovations (L, C, T, m) of values (L or 1, N, m) in units of the scale."""
        grid = np.zeros((len(values), *self.structure.shape, values.shape[2]))
        grid[:, *self.structure.slot] = values
        count = len(self.laws)
        out = np.empty((count, *grid.shape[1:]))
        state = np.zeros((count, grid.shape[1], grid.shape[3]))
        for t in range(grid.shape[2]):
            state = self._decay[:, :, t, None] * state
            innovation = grid[:, :, t] - state
            state = state + self._gain[:, :, t, None] * innovation
            out[:, :, t] = innovation / self._sd[:, :, t, None]
        return out * self.structure.present[:, :, None]

    @functools.cached_property
    def _columns(self) -> Array:
        """Filtered errors that a run shares (L, C, T, K)."""
        amounts = self.laws.sizes[:, self.structure.kinds]
        filtered = self._filter(self.structure.columns[None])
        return np.asarray(filtered * amounts[:, None, None, :])

    @functools.cached_property
    def _spectrum(self) -> tuple[Array, Array]:
        """Eigenvalues and vectors of each run's shared errors (L, R, K), (L, R, K, K)."""
        values, vectors = np.linalg.eigh(self._run_products(self._columns))
        return np.maximum(values, 0.0), vectors

    def _run_products(self, values: Array) -> Array:
        """Sums (L, R, K, m) over each run of shared errors times values (L, C, T, m)."""
        by_chain = np.einsum("lctk,lctm->lckm", self._columns, values, optimize=True)
        return np.add.reduceat(by_chain, self.structure.first_chains, axis=1)

    @functools.cached_property
    def log_determinant(self) -> Array:
        """Log determinants (L,) of the covariances, in units of the stated noise."""
        present = self.structure.present
        filtered = 2.0 * np.einsum("lct,ct->l", np.log(self._sd), present)
        shared = np.log1p(self._spectrum[0]).sum(axis=(1, 2))
        return np.asarray(filtered + shared + 2.0 * np.log(self._scale).sum(axis=1))

    def gram(self, values: Array) -> Array:
        """Products Y^T C^-1 Y (L, m, m), for standardised Y (N, m) or (L, N, m)."""
        batch = values if values.ndim == 3 else values[None]
        filtered = self._filter(batch / self._scale[:, :, None])
        whole = np.einsum("lctm,lctn->lmn", filtered, filtered, optimize=True)
        sizes, vectors = self._spectrum
        projected = np.swapaxes(vectors, 2, 3) @ self._run_products(filtered)
        share = projected / (1.0 + sizes[..., None])
        removed = np.einsum("lrkm,lrkn->lmn", projected, share, optimize=True)
        return np.asarray(whole - removed)

    def whiten(self, values: Array) -> Array:
        """W Y (L, N, m) with W C W^T = 1, for standardised Y (N, m) or (L, N, m)."""
        batch = values if values.ndim == 3 else values[None]
        filtered = self._filter(batch / self._scale[:, :, None])
        sizes, vectors = self._spectrum
        root = 1.0 / np.sqrt(1.0 + sizes) - 1.0
        factor = np.where(sizes > 1e-12, root / np.maximum(sizes, 1e-300), -0.5)
        projected = np.swapaxes(vectors, 2, 3) @ self._run_products(filtered)
        change = vectors @ (factor[..., None] * projected)
        of_chain = change[:, self.structure.run]
        whitened = filtered + self._columns @ of_chain
        return np.asarray(whitened[:, *self.structure.slot])

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
        count, chains, length = self._decay.shape
        white = rng.standard_normal((2, count, chains, length))
        carried, state = np.empty_like(self._decay), np.zeros((count, chains))
        for t in range(length):
            decay = self._decay[:, :, t]
            state = decay * state + np.sqrt(1.0 - decay**2) * white[0, :, :, t]
            carried[:, :, t] = state
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
        return np.asarray(self._scale * (single[:, *self.structure.slot] + common))


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
