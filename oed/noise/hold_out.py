"""Innovations of held-out readings given the others, in linear time.

With O the inverse covariance of all readings and O_hh that of the held-out ones among
them, L^-1 (O v)_h is what the others do not predict of v, whitened: O_hh = L L^T. What a
chain carries has, given all readings, a covariance K that is Markovian again. So

    O_hh = E^-1 - E^-1 K_hh E^-1 - A_h A_h^T,

E the variances of single readings, has the form that `oed.noise.banded` factors; A is
what segments share.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.noise.banded import ChainFactor, along_chains
from oed.noise.factor import Errors, LinearFactor
from oed.noise.shared import SharedFactor


class Innovations:
    """Innovations of held-out readings among all, of a factor of their covariance."""

    def __init__(self, factor: LinearFactor, chains: Chains, held: Index) -> None:
        """Factor the precision of the readings `held` (h,)."""
        errors = factor.errors
        place = np.empty(len(errors.order), dtype=np.intp)
        place[errors.order] = np.arange(len(place))
        self._at = np.sort(place[held])
        self._rank = np.argsort(np.argsort(place[held]))
        self._banded = chains.precision_of(self._at)
        shared = self._banded.whiten(factor.scored_root()[self._at])
        segment = np.searchsorted(errors.starts, self._at, side="right")
        starts = np.flatnonzero(np.diff(segment, prepend=-1) > 0)
        self._shared = SharedFactor(shared, starts, sign=-1.0)

    def innovations(self, scored: Array) -> Array:
        """Innovations (h, m), in the order of the held-out readings.

        scored  (k, m) precision times standardised values, of all readings in order
        """
        white = self._shared.whiten(self._banded.whiten(scored[self._at]))
        return white[self._rank]


class Chains:
    """What chains carry, given all readings: a Markov chain forward along each.

    K_jj = psi_j^2 K_bb + q_j for the reading b before j, of carried errors over the
    variances of single readings.
    """

    def __init__(self, errors: Errors) -> None:
        """Condition on all readings; no single error may be exact."""
        self._precision = 1.0 / errors.single
        self._chain = np.cumsum(errors.decay == 0.0)
        self._carried = bool(errors.carried.any())
        if self._carried:
            self._condition(errors.decay, errors.fresh)

    def _condition(self, decay: Array, fresh: Array) -> None:
        diagonal = self._precision + 1.0 / fresh
        diagonal[:-1] += decay[1:] ** 2 / fresh[1:]
        neighbour = -decay[1:] / fresh[1:]
        # pivots from the last reading on: each given the one before, the later ones out
        band = np.vstack([diagonal[::-1], [*neighbour[::-1], 0.0]])
        pivot = linalg.cholesky_banded(band, lower=True, check_finite=False)[0, ::-1]
        variance = 1.0 / pivot**2
        step = np.concatenate([[0.0], -neighbour * variance[1:]])
        # steps multiply along a chain: sums of logarithms
        self._log_steps = np.cumsum(np.log(np.where(step > 0.0, step, 1.0)))
        self._marginal = along_chains(step**2, variance)

    def precision_of(self, at: Index) -> ChainFactor:
        """Factor of E^-1 - E^-1 K E^-1 for the readings at places `at` (h,), in order."""
        single = self._precision[at]
        if not self._carried:
            nothing = np.zeros(len(at))
            return ChainFactor(nothing, single, nothing)
        same = np.diff(self._chain[at], prepend=0) == 0
        log_step = np.diff(self._log_steps[at], prepend=0.0)
        step = np.exp(np.where(same, log_step, -np.inf))
        decay, fresh = step * single, self._marginal[at]
        decay[1:] /= single[:-1]
        fresh[1:] -= step[1:] ** 2 * self._marginal[at[:-1]]
        return ChainFactor(decay, single, -fresh * single**2)
