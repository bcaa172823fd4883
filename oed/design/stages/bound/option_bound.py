"""One option in the bound over all plans: its rows, times, and bounded information."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array
from oed.design.stages.option import Option
from oed.design.stages.stage.travel import capture_probability_bound


@dataclasses.dataclass(frozen=True, eq=False)
class OptionBound:
    """Candidates (C) of an option, weighted with a bound of their capture probability.

    machine  (C, k, n) parts of the rows on the machine's parameters
    setup    (C, k, r) parts of the rows on the option's other unknowns
    cost     (C,) time of each candidate, s
    limit    largest number of candidates in a plan
    """

    machine: Array
    setup: Array
    cost: Array
    limit: int

    @classmethod
    def of(cls, option: Option, n: int) -> OptionBound:
        """An option whose readings are lost to its set-up's unknowns alone."""
        probability = capture_probability_bound(option, np.zeros((n, n)))
        weights = np.sqrt(probability)[:, None, None]
        blocks = option.candidates.blocks * weights
        return cls(
            machine=blocks[:, :, :n],
            setup=blocks[:, :, n:],
            cost=option.candidate_seconds,
            limit=option.counts[-1],
        )

    @property
    def longest(self) -> float:
        """Longest time (s) that the readings of a plan can take."""
        return float(np.sort(self.cost)[-self.limit :].sum())

    def profile(self, weights: Array) -> Array:
        """G (r, n) that attains the minimum S at weights (C,)."""
        of_setup = np.einsum(
            "c,ckr,cks->rs", weights, self.setup, self.setup, optimize=True
        )
        mixed = np.einsum(
            "c,ckr,ckn->rn", weights, self.setup, self.machine, optimize=True
        )
        return np.asarray(np.linalg.solve(of_setup + np.eye(len(of_setup)), mixed))

    def information(self, weights: Array, profile: Array) -> Array:
        """S (n, n) at weights (C,) and a profile G (r, n)."""
        residual = self.machine - self.setup @ profile
        weighted = residual * np.sqrt(weights)[:, None, None]
        rows = weighted.reshape(-1, weighted.shape[2])
        return np.asarray(rows.T @ rows + profile.T @ profile)

    def gain(self, profile: Array, root: Array) -> Array:
        """Gain (C,) of each candidate, |(x - z G) R|^2."""
        moved = (self.machine - self.setup @ profile) @ root
        return np.asarray(np.sum(moved**2, axis=(1, 2)))

    def worth(self, gain: Array, prices: Array) -> Array:
        """Largest total (P,) of gains (C,) minus the price of time, at each price (P,).

        At most `limit` candidates contribute.
        """
        net = np.maximum(gain - prices[:, None] * self.cost, 0.0)
        if self.limit < net.shape[1]:
            net = np.partition(net, -self.limit, axis=1)[:, -self.limit :]
        return np.asarray(net.sum(axis=1))
