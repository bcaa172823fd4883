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
from oed.noise.banded import BandedFactor
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
        self._chain = _chain_numbers(errors.before)
        self._size = len(errors.order)
        self._carried = bool(errors.carried.any())
        if self._carried:
            self._condition(errors)

    def _condition(self, errors: Errors) -> None:
        order = np.lexsort((np.arange(self._size), self._chain))
        decay = errors.decay[order]
        fresh = errors.carried[order] * (1.0 - decay**2)
        diagonal = self._precision[order] + 1.0 / fresh
        diagonal[:-1] += decay[1:] ** 2 / fresh[1:]
        neighbour = -decay[1:] / fresh[1:]
        # pivots from the last reading on: each given the one before, the later ones out
        band = np.vstack([diagonal[::-1], [*neighbour[::-1], 0.0]])
        pivot = linalg.cholesky_banded(band, lower=True, check_finite=False)[0, ::-1]
        variance = 1.0 / pivot**2
        step = np.concatenate([[0.0], -neighbour * variance[1:]])
        self._order = order
        self._log_step = np.log(np.where(step > 0.0, step, 1.0))
        self._marginal = _variances(step, variance)

    def precision_of(self, at: Index) -> BandedFactor:
        """Factor of E^-1 - E^-1 K E^-1 for the readings at places `at` (h,), in order."""
        single = self._precision[at]
        before = _before_of(self._chain[at])
        decay = np.zeros(len(at))
        if not self._carried:
            return BandedFactor(before, decay, single, decay)
        # steps multiply along a chain: sums of logarithms
        total = np.empty(self._size)
        total[self._order] = np.cumsum(self._log_step)
        marginal = np.empty(self._size)
        marginal[self._order] = self._marginal
        later = before != np.arange(len(at))
        here, there = at[later], at[before[later]]
        step = np.exp(total[here] - total[there])
        decay[later] = step * single[later] / single[before[later]]
        fresh = marginal[at]
        fresh[later] -= step**2 * marginal[there]
        return BandedFactor(before, decay, single, -fresh * single**2)


def _variances(step: Array, fresh: Array) -> Array:
    """v_j = step_j^2 v_(j-1) + fresh_j, step_0 = 0."""
    variances, last = np.empty(len(step)), 0.0
    squares = step**2
    for k in range(len(step)):
        last = squares[k] * last + fresh[k]
        variances[k] = last
    return variances


def _chain_numbers(before: Index) -> Index:
    """Number (k,) of the chain of each reading: its first reading."""
    chain = np.arange(len(before))
    for k in np.flatnonzero(before != chain):
        chain[k] = chain[before[k]]
    return chain


def _before_of(chain: Index) -> Index:
    """Place (h,) of the reading before in the same chain; its own for the first."""
    order = np.argsort(chain, kind="stable")
    before = np.arange(len(chain))
    same = chain[order[1:]] == chain[order[:-1]]
    before[order[1:][same]] = order[:-1][same]
    return before
