"""Independent ensembles of walkers that sample one density in blocks of steps.

The walkers of one ensemble propose from each other, so they are no independent chains:
only ensembles with starts and random numbers of their own show whether sampling agrees
with itself (R-hat).
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from oed.base import Array
from oed.posterior.checkpoint import Chain, Checkpoint, open_chain
from oed.posterior.log_density import LogDensity

#: ensembles, and fewest walkers of each
ENSEMBLES, LEAST_WALKERS = 4, 16
#: shares of the two kinds of moves
LAPLACE_SHARE, EVOLUTION_SHARE = 0.6, 0.4


#: points (count, dimensions) to start from
Starts = Callable[[np.random.Generator, int], Array]


def ensemble_sizes(walkers: int | None, dimensions: int) -> list[int]:
    """Walkers of each ensemble; `walkers` in all, as many as are needed by default.

    Fewer than twice the dimensions in all would not span them: these are taken then.
    """
    if walkers is None:
        return [max(2 * (dimensions + 2), LEAST_WALKERS)] * ENSEMBLES
    walkers = max(walkers, 2 * dimensions + 2)
    count = max(1, min(ENSEMBLES, walkers // (2 * dimensions)))
    return [len(part) for part in np.array_split(np.arange(walkers), count)]


@dataclasses.dataclass
class Ensemble:
    """One ensemble: emcee's sampler, where it stands, where its chain is saved."""

    sampler: Any
    state: Any
    chain: Chain

    @property
    def iteration(self) -> int:
        """Steps so far."""
        return int(self.sampler.iteration)


class Ensembles:
    """Ensembles of one density; `determining` are arrays that determine the chains.

    They start about the estimate, or at `starts`. An ensemble with a checkpoint goes on where its saved chain ends.
    """

    def __init__(
        self,
        target: LogDensity,
        sizes: Sequence[int],
        rng: np.random.Generator,
        checkpoint: Checkpoint | None,
        determining: Iterable[Array],
        starts: Starts | None = None,
    ) -> None:
        self._target, self._starts = target, starts or target.starts
        given = tuple(determining)
        self._members = [
            self._ensemble(k, size, rng, checkpoint, given)
            for k, size in enumerate(sizes)
        ]

    def _ensemble(
        self,
        number: int,
        size: int,
        rng: np.random.Generator,
        checkpoint: Checkpoint | None,
        given: tuple[Array, ...],
    ) -> Ensemble:
        import emcee

        target, shape = self._target, (size, self._target.dimensions)
        start = self._starts(rng, size)
        random: Any = np.random.RandomState(rng.integers(2**31)).get_state()
        if checkpoint is not None:
            folder = checkpoint.folder / str(number)
            checkpoint = dataclasses.replace(checkpoint, folder=folder)
        chain = open_chain(checkpoint, shape, (*given, start, random[1]))
        moves = [
            (emcee.moves.MHMove(target.propose), LAPLACE_SHARE),
            (emcee.moves.DEMove(), EVOLUTION_SHARE),
        ]
        sampler = emcee.EnsembleSampler(
            *shape, target, vectorize=True, moves=moves, backend=chain.backend
        )
        state = emcee.State(start, random_state=random)
        if sampler.iteration > 0:
            state = sampler.get_last_sample()
        return Ensemble(sampler, state, chain)

    @property
    def iteration(self) -> int:
        """Steps that every ensemble has run."""
        return min(member.iteration for member in self._members)

    @property
    def saved(self) -> int:
        """Steps of the ensemble that is farthest: more than 0 where a run is resumed."""
        return max(member.iteration for member in self._members)

    @property
    def walkers(self) -> int:
        """Walkers of all ensembles."""
        return sum(member.sampler.nwalkers for member in self._members)

    @property
    def acceptance(self) -> float:
        """Mean share of accepted steps."""
        shares = [member.sampler.acceptance_fraction for member in self._members]
        return float(np.mean(np.concatenate(shares)))

    def run_to(self, steps: int) -> None:
        """Let every ensemble run to so many steps, and save what was added.

        Raises KeyboardInterrupt, OSError.
        """
        for member in self._members:
            begin = member.iteration
            if begin >= steps:
                continue
            for latest in member.sampler.sample(member.state, iterations=steps - begin):
                member.state = latest
                if self._target.interrupted:
                    raise KeyboardInterrupt
            member.chain.save(begin)

    def chains(self, burn_in: int) -> Array:
        """Points (walkers, steps, dimensions) of all ensembles after the burn-in."""
        parts = [
            np.swapaxes(member.sampler.get_chain(discard=burn_in), 0, 1)
            for member in self._members
        ]
        return np.concatenate(parts)

    def by_ensemble(self, values: Array) -> Array:
        """Values (walkers, steps, k) as (ensembles, steps times walkers, k).

        Each ensemble has as many walkers as the smallest one. A single ensemble's
        walkers stay chains of their own.
        """
        sizes = [member.sampler.nwalkers for member in self._members]
        if len(sizes) == 1:
            return values
        starts, least = np.cumsum([0, *sizes[:-1]]), min(sizes)
        parts = [np.swapaxes(values[s : s + least], 0, 1) for s in starts]
        shape = (len(parts), least * values.shape[1], values.shape[2])
        return np.stack(parts).reshape(shape)

    def autocorrelation(self) -> float:
        """Longest integrated autocorrelation time, in steps (emcee)."""
        import emcee

        chain = np.swapaxes(self.chains(0), 0, 1)
        with warnings.catch_warnings():
            # Chains that are too short go on; they need no warning.
            warnings.simplefilter("ignore")
            times = emcee.autocorr.integrated_time(chain, tol=0)
        return float(np.nanmax(np.where(np.isfinite(times), times, self.iteration)))
