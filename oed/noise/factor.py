"""Root of a law's covariance in time linear in the number of readings.

The readings are put in order, chain after chain and segment after segment; each segment is
independent of the others. Within a segment

    C = P S (D^-1 T D^-T + U U^T) S P^T,

P relates the channels of a reading, S scales readings, the banded part holds white and
correlated errors and U what the segment shares (`oed.noise.banded`).

Innovations of held-out readings given the others are linear as well. With O the inverse
covariance of all readings and O_hh that of the held-out ones among them, L^-1 (O v)_h
is what the others do not predict of v, whitened: O_hh = L L^T. What a chain carries
has, given all readings, a covariance K that is Markovian again. So

    O_hh = E^-1 - E^-1 K_hh E^-1 - A_h A_h^T,

E the variances of single readings, has the form of a banded part again; A is what
segments share.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import scipy

from oed.base import Array, Index
from oed.noise.banded import (
    ChainFactor,
    SharedFactor,
    SharedProducts,
    chain_errors,
    chain_sums,
)

#: columns that are whitened back at once: more take memory and no less time
COLUMNS_AT_ONCE = 64
PRECISION_TOLERANCE = 1e-12  #: share of a precision below which it is rounding


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Errors:
    """Errors of k readings in order, in units of their scales."""

    order: Index  #: (k,) numbers of the readings
    starts: Index  #: (S,) first reading of each segment
    #: (k,) correlation with that part of the reading before; 0 for the first of a chain
    decay: Array
    single: Array  #: (k,) variances of the white part
    correlated: Array  #: (k,) variances of the correlated part, alike within a chain
    shared: Array  #: (k, K) errors that a segment shares
    scale: Array  #: (k,)
    #: (k, k) sparse P^-1, lower triangular; None: 1
    unmix: scipy.sparse.csr_array | None = None

    def standardise(self, values: Array) -> Array:
        """Values (N, m) of the readings in order (k, m), over P and scale."""
        ordered = values[self.order]
        if self.unmix is not None:
            ordered = self.unmix @ ordered
        ordered /= self.scale[:, None]
        return np.asarray(ordered)

    def unstandardise(self, scored: Array) -> Array:
        """P^-T Y (N, m) over scale, each row where its reading stands, for Y (k, m)."""
        values = scored / self.scale[:, None]
        if self.unmix is not None:
            values = self.unmix.T @ values
        return _unordered(self.order, values)

    @property
    def fresh(self) -> Array:
        """Variances (k,) of what joins the correlated part."""
        return self.correlated * (1.0 - self.decay**2)

    def covariance_of(self, values: Array) -> Array:
        """Y^T C Y (m, m), for Y (N, m): of sums of the errors. P is 1."""
        ordered = values[self.order] * self.scale[:, None]
        covariance = ordered.T @ (ordered * self.single[:, None])
        correlated = chain_sums(self.decay, ordered)
        covariance += correlated.T @ (correlated * self.fresh[:, None])
        ends = [*self.starts[1:], len(ordered)]
        for start, end in zip(self.starts, ends, strict=True):
            segment = ordered[start:end].T @ self.shared[start:end]
            covariance += segment @ segment.T
        return np.asarray(covariance)


class LinearFactor:
    """Root of errors that are banded but for a few that each segment shares."""

    def __init__(self, errors: Errors) -> None:
        self.errors, self.order = errors, errors.order
        #: root of the errors that are white and correlated, for standardised values
        self.banded = ChainFactor(errors.decay, errors.single, errors.fresh)
        self._columns = self.banded.whiten(errors.shared)
        self._shared = SharedProducts(self._columns, errors.starts)
        log_sizes = float(self.banded.log_variances.sum()) + self._shared.log_det
        log_scale = float(np.log(errors.scale).sum())
        if errors.unmix is not None:
            log_scale -= float(np.log(errors.unmix.diagonal()).sum())
        #: log determinant of the covariance
        self.log_det = 2.0 * log_scale + log_sizes

    def whiten(self, values: Array) -> Array:
        """W Y (k, m) with W C W^T = 1, for Y (N, m)."""
        alone = self.banded.whiten(self.errors.standardise(values))
        return self._shared.whiten(alone)

    def whiten_back(self, white: Array) -> Array:
        """W^T Y (N, m), for Y (k, m) in order and the W of `whiten`."""
        return self.errors.unstandardise(self.whiten_back_standard(white.copy()))

    def whiten_back_standard(self, white: Array) -> Array:
        """The same (k, m) of standardised values, in order; Y is overwritten."""
        return self.banded.whiten_back(self._shared.whiten(white))

    def correlate(self, white: Array) -> Array:
        """R Y (k, m) in order, for white Y (k, m) and Cholesky's root R."""
        errors = self.errors
        shared = SharedFactor(self._columns, errors.starts)
        values = self.banded.unwhiten(shared.unwhiten(white)) * errors.scale[:, None]
        if errors.unmix is not None:
            values = scipy.sparse.linalg.spsolve_triangular(errors.unmix, values)
        return np.asarray(values)

    def precision(self, values: Array) -> Array:
        """C^-1 Y (N, m), for Y (N, m), of a factor of all readings."""
        scored = self.scored(self.errors.standardise(values))
        return self.errors.unstandardise(scored)

    def scored(self, standard: Array) -> Array:
        """The precision of standardised values (k, m) times them."""
        white = self.banded.whiten(standard)
        return self.banded.whiten_back(white - self._shared.shared_part(white))

    def scored_root(self) -> Array:
        """A (k, K): a segment's precision is that without shared errors less A A^T."""
        return self.banded.whiten_back(self._shared.root())

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of C^-1, of a factor of all readings."""
        errors = self.errors
        diagonal = self.banded.precision_diagonal() / errors.scale**2
        if errors.unmix is not None:
            # channels are independent where they are not mixed
            diagonal = np.asarray(errors.unmix.power(2).T @ diagonal)
        shared = errors.unstandardise(self.scored_root())
        explained: Array = (shared**2).sum(axis=1)
        return _unordered(errors.order, diagonal) - explained

    def scaled(self, factor: float) -> "LinearFactor":
        """The root of errors times a factor."""
        errors = self.errors
        return LinearFactor(dataclasses.replace(errors, scale=factor * errors.scale))

    def widened(self, columns: Array) -> "WideFactor":
        """Root of the covariance and G G^T, for columns G (N, k) that all readings share."""
        return WideFactor(self, columns)

    def hold_out(self, numbers: Index) -> "Innovations":
        """Innovations of readings (h,), by number, given all others."""
        return Innovations(self, self._chains, numbers)

    @functools.cached_property
    def _chains(self) -> "Chains":
        return Chains(self.errors)


class WideFactor:
    """Root of C + G G^T, for the factor of C and columns G (N, k) that all readings share.

    With W G = B diag(s) V^T, W that of C, it is [1 - B (1 - 1 / sqrt(1 + s^2)) B^T] W.
    """

    def __init__(self, factor: LinearFactor, columns: Array) -> None:
        self.alone, self.order = factor, factor.order
        self._columns = columns
        axes, triangle = scipy.linalg.qr(
            np.asfortranarray(factor.whiten(columns)),
            mode="economic",
            check_finite=False,
            overwrite_a=True,
        )
        rotation, self.sizes, self.turn = scipy.linalg.svd(
            triangle, full_matrices=False, check_finite=False
        )
        #: (N, k) B, along which what the columns absorb lies
        self.axes: Array = axes @ rotation
        #: log determinant of the covariance
        self.log_det = factor.log_det + float(np.log1p(self.sizes**2).sum())

    def whiten(self, values: Array) -> Array:
        """Whitened values (N, m), in order, for Y (N, m)."""
        return self.remaining(self.alone.whiten(values))

    def remaining(self, white: Array) -> Array:
        """Values (N, m) whitened by C less what the columns absorb of them."""
        shrink = 1.0 - 1.0 / np.hypot(1.0, self.sizes)[:, None]
        return np.asarray(white - self.axes @ (shrink * (self.axes.T @ white)))

    def whiten_back(self, white: Array) -> Array:
        """The transpose of `whiten` times Y (N, m)."""
        return self.alone.whiten_back(self.remaining(white))

    def precision(self, values: Array) -> Array:
        """(C + G G^T)^-1 Y (N, m), for Y (N, m)."""
        return self.whiten_back(self.whiten(values))

    def absorbed_root(self) -> Array:
        """A (k, n): the precision of standardised values is that of C less A A^T."""
        share = self.sizes / np.hypot(1.0, self.sizes)
        return self.alone.whiten_back_standard(self.axes * share)

    def precision_diagonal(self) -> Array:
        """Diagonal (N,) of (C + G G^T)^-1.

        Of readings that the columns alone determine it is rounding about 0.
        """
        alone = self.alone.precision_diagonal()
        absorbed = np.zeros(len(alone))
        share = self.sizes / np.hypot(1.0, self.sizes)
        for start in range(0, len(share), COLUMNS_AT_ONCE):
            some = slice(start, start + COLUMNS_AT_ONCE)
            back = self.alone.whiten_back(self.axes[:, some] * share[some])
            absorbed += (back**2).sum(axis=1)
        return np.maximum(alone - absorbed, PRECISION_TOLERANCE * alone)

    def scaled(self, factor: float) -> "WideFactor":
        """The root of errors times a factor."""
        return WideFactor(self.alone.scaled(factor), factor * self._columns)


def joined(parts: Sequence[Errors]) -> Errors:
    """Errors of readings that stand one after the other, each set in its own order."""
    counts = [len(part.order) for part in parts]
    first = np.cumsum([0, *counts[:-1]])
    widest = max(part.shared.shape[1] for part in parts)

    def stacked(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts])

    def numbers(name: str) -> Index:
        pairs = zip(parts, first, strict=True)
        return np.concatenate([getattr(part, name) + start for part, start in pairs])

    shared = [
        np.pad(part.shared, ((0, 0), (0, widest - part.shared.shape[1])))
        for part in parts
    ]
    unmix = [
        scipy.sparse.eye_array(count) if part.unmix is None else part.unmix
        for part, count in zip(parts, counts, strict=True)
    ]
    return Errors(
        order=numbers("order"),
        starts=numbers("starts"),
        decay=stacked("decay"),
        single=stacked("single"),
        correlated=stacked("correlated"),
        shared=np.concatenate(shared),
        scale=stacked("scale"),
        unmix=scipy.sparse.csr_array(scipy.sparse.block_diag(unmix)),
    )


def _unordered(order: Index, ordered: Array) -> Array:
    """Values (N, ...) of all readings, which stand in an order."""
    values = np.empty_like(ordered)
    values[order] = ordered
    return values


class Innovations:
    """Innovations of held-out readings among all, of a factor of their covariance."""

    def __init__(self, factor: LinearFactor, chains: "Chains", numbers: Index) -> None:
        """Factor the precision of the readings with these numbers (h,)."""
        errors = factor.errors
        row_of = np.empty(len(errors.order), dtype=np.intp)
        row_of[errors.order] = np.arange(len(row_of))
        self._rows = np.sort(row_of[numbers])
        self._rank = np.argsort(np.argsort(row_of[numbers]))
        self._banded = chains.precision_of(self._rows)
        shared = self._banded.whiten(factor.scored_root()[self._rows])
        segment = np.searchsorted(errors.starts, self._rows, side="right")
        starts = np.flatnonzero(np.diff(segment, prepend=-1) > 0)
        self._shared = SharedFactor(shared, starts, sign=-1.0)

    def innovations(self, scored: Array) -> Array:
        """Innovations (h, m) held out; scored (k, m): precision times values."""
        white = self._shared.whiten(self._banded.whiten(scored[self._rows]))
        return white[self._rank]


class Chains:
    """What chains carry, given all readings: a Markov chain forward along each.

    K_jj = psi_j^2 K_bb + q_j for the reading b before j, of correlated errors over the
    variances of single readings.
    """

    def __init__(self, errors: Errors) -> None:
        """Condition on all readings; no single error may be exact."""
        self._precision = 1.0 / errors.single
        self._chain = np.cumsum(errors.decay == 0.0)
        self._has_correlation = bool(errors.correlated.any())
        if self._has_correlation:
            self._condition(errors.decay, errors.fresh)

    def _condition(self, decay: Array, fresh: Array) -> None:
        diagonal = self._precision + 1.0 / fresh
        diagonal[:-1] += decay[1:] ** 2 / fresh[1:]
        neighbour = -decay[1:] / fresh[1:]
        # pivots from the last reading on: each given the one before, the later ones out
        band = np.vstack([diagonal[::-1], [*neighbour[::-1], 0.0]])
        pivot = scipy.linalg.cholesky_banded(band, lower=True, check_finite=False)[
            0, ::-1
        ]
        variance = 1.0 / pivot**2
        step = np.concatenate([[0.0], -neighbour * variance[1:]])
        # steps multiply along a chain: sums of logarithms
        self._log_steps = np.cumsum(np.log(np.where(step > 0.0, step, 1.0)))
        self._marginal = chain_errors(step**2, variance)

    def precision_of(self, rows: Index) -> ChainFactor:
        """Factor of E^-1 - E^-1 K E^-1 for rows (h,) of the readings in order."""
        single = self._precision[rows]
        if not self._has_correlation:
            zeros = np.zeros(len(rows))
            return ChainFactor(zeros, single, zeros)
        same = np.diff(self._chain[rows], prepend=0) == 0
        log_step = np.diff(self._log_steps[rows], prepend=0.0)
        step = np.exp(np.where(same, log_step, -np.inf))
        decay = step * single
        fresh = self._marginal[rows]
        decay[1:] /= single[:-1]
        fresh[1:] -= step[1:] ** 2 * self._marginal[rows[:-1]]
        return ChainFactor(decay, single, -fresh * single**2)
