"""How readings hang together: runs, chains of one channel, renewed set-up unknowns.

A run is a circle, a line, a series of poses read without a break. A chain is one
channel of a run. Errors may be common to a chain, follow each other along it, or come
from a set-up unknown that a run seats anew (a magnetic cup, ISO 230-4).
"""

import dataclasses
import enum
import functools

import numpy as np
import scipy

from oed.base import Array, Index, Mask
from oed.noise.statement import NOTHING_STATED, NoiseStatement


class SharedError(enum.IntEnum):
    """Kinds of errors that a run shares.

    LEVEL                      level of unknown size
    KNOWN                      level of known size, that of a reference reading
    RENEWED                    unknown of unknown size that each run seats anew
    STATED_LEVEL, STATED_SEAT  level and seating whose sizes are stated
    """

    LEVEL = 0
    KNOWN = 1
    RENEWED = 2
    STATED_LEVEL = 3
    STATED_SEAT = 4


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ReadingStructure:
    """N readings in C chains of R runs; chains are numbered run by run."""

    #: of the groups of readings that share a noise scale, `set-up.channel`
    names: tuple[str, ...]
    group: Index  #: (N,) group of each reading
    chain: Index  #: (N,) chain of each reading
    run: Index  #: (C,) run of each chain
    position: Array  #: (N,) along the chain, in readings
    unit: Array  #: (N,) standard deviation of the stated noise that is not shared, SI
    #: (N, N) sparse: readings whose channels have common sources, made independent and
    #: of unit noise; None where division by `unit` does it
    decouple: scipy.sparse.csr_array | None
    columns: Array  #: (N, K) errors that a run shares, in units of the stated noise
    kinds: Index  #: (K,) of these errors, as numbers of `SharedError`
    #: of the parts that all readings have: correlated noise, tails
    statement: NoiseStatement = NOTHING_STATED
    #: (N, c) modes of what each group's readings share through the session, of unit
    #: standard deviation at its end (`oed.measurement.noise_structure`)
    course: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    #: (N, k) changes per standard deviation of independent normal coefficients that all
    #: readings share: what the model lacks, in units of the stated noise
    effects: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def has_effects(self) -> bool:
        """Whether effects that the model lacks widen the covariance."""
        return bool(self.effects.size)

    def __len__(self) -> int:
        return len(self.group)

    @functools.cached_property
    def slot(self) -> tuple[Index, Index]:
        """Chain and number within it of each reading, for arrays (C, T, ...)."""
        order = np.lexsort((self.position, self.chain))
        first = np.searchsorted(self.chain[order], np.arange(len(self.run)))
        number = np.empty(len(self), dtype=np.intp)
        number[order] = np.arange(len(self)) - first[self.chain[order]]
        return self.chain, number

    @functools.cached_property
    def shape(self) -> tuple[int, int]:
        """Number of chains, and readings of the longest one."""
        return len(self.run), int(self.slot[1].max()) + 1

    @property
    def longest(self) -> int:
        """Length of the longest chain, in steps of `position`."""
        ends = np.full((2, len(self.run)), -np.inf)
        np.maximum.at(ends[0], self.chain, self.position)
        np.maximum.at(ends[1], self.chain, -self.position)
        return 1 + int(ends.sum(axis=0).max())

    @functools.cached_property
    def first_chains(self) -> Index:
        """First chain of each run (R,)."""
        return np.flatnonzero(np.r_[True, np.diff(self.run) > 0])

    @functools.cached_property
    def steps(self) -> Array:
        """Distance (C, T) in readings from the one before in a chain, or inf."""
        position = np.full(self.shape, np.nan)
        position[self.slot] = self.position
        steps = np.diff(position, axis=1, prepend=np.nan)
        return np.where(np.isnan(steps), np.inf, steps)

    @functools.cached_property
    def reading_of_slot(self) -> tuple[Index, Mask]:
        """Reading of each slot (C, T), and which slots have none."""
        reading = np.full(self.shape, -1, dtype=np.intp)
        reading[self.slot] = np.arange(len(self))
        return reading, reading < 0

    @functools.cached_property
    def group_of_chain(self) -> Index:
        """Group (C,) of the readings of each chain: a chain is one channel of a set-up."""
        of_chain = np.zeros(len(self.run), dtype=np.intp)
        of_chain[self.chain] = self.group
        return of_chain

    @functools.cached_property
    def chains_of_group(self) -> list[Index]:
        """Chains of each group."""
        groups = range(len(self.names))
        return [np.flatnonzero(self.group_of_chain == group) for group in groups]

    @functools.cached_property
    def variances(self) -> Array:
        """Mean variances (G, G), SI, of each group's readings by each decoupled group."""
        mixing = scipy.sparse.csr_array(scipy.sparse.diags_array(self.unit))
        if self.decouple is not None:
            mixed = scipy.sparse.linalg.inv(self.decouple.tocsc())
            mixing = scipy.sparse.csr_array(mixed)
        entries = (np.arange(len(self)), self.group)
        members = scipy.sparse.csr_array((np.ones(len(self)), entries))
        squares = (members.T @ mixing.power(2) @ members).toarray()
        return np.asarray(squares / np.bincount(self.group)[:, None])

    @functools.cached_property
    def log_unit(self) -> float:
        """Sum of the logs of the units of readings, SI."""
        if self.decouple is None:
            return float(np.log(self.unit).sum())
        return -float(np.log(self.decouple.diagonal()).sum())

    @functools.cached_property
    def members(self) -> tuple[Index, ...]:
        """Readings of each run."""
        run = self.run[self.chain]
        return tuple(np.flatnonzero(run == number) for number in np.unique(run))

    def rescaled(self, sigma: Array) -> "ReadingStructure":
        """The structure of readings that are divided by noises sigma (N,), SI."""
        decouple = self.decouple
        if decouple is not None:
            scaled = decouple @ scipy.sparse.diags_array(sigma)
            decouple = scipy.sparse.csr_array(scaled)
        return dataclasses.replace(self, unit=self.unit / sigma, decouple=decouple)

    def standardise(self, values: Array) -> Array:
        """Values (N,) or (N, m), SI, in units of the stated noise, channels decoupled."""
        if self.decouple is not None:
            return np.asarray(self.decouple @ values)
        return values / self.unit.reshape(-1, *[1] * (values.ndim - 1))

    def restore(self, values: Array) -> Array:
        """Standardised values (..., N) in SI: the inverse of `standardise`."""
        if self.decouple is None:
            return values * self.unit
        flat = values.reshape(-1, len(self))
        solution = scipy.sparse.linalg.spsolve(self.decouple.tocsc(), flat.T)
        return np.asarray(solution).T.reshape(values.shape)
