"""Quotas: how many readings a plan takes from selections of the candidates.

A quota bounds a count, least <= sum_(i in S) x_i <= most, for a selection S of the
candidates. Candidates with the same quotas form a class, and a plan keeps the quotas if
its numbers n_g in the classes do. Whether such numbers exist, and which are nearest to
a target, is an integer programme of the size of the classes:

    minimise  sum_g |n_g - t_g|   over   least <= P n <= most,  sum_g n_g = N,  taken_g <= n_g <= available_g,

with P the membership of the classes. The relaxation takes the quotas as linear limits
on the weights (`oed.design.conic`).
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import scipy  # its parts load when first used

from oed.base import Array, Index, Mask


@dataclasses.dataclass(frozen=True, eq=False)
class Quota:
    """Number of candidates that a plan takes from a selection."""

    name: str  #: for messages
    members: Mask  #: (C,) which candidates are selected
    least: int = 0  #: number, at the least
    most: int | None = None  #: number, at the most; None: no limit

    @property
    def sentence(self) -> str:
        """The quota in words: at least 3 of "high" (12 candidates)."""
        limits = []
        if self.least:
            limits.append(f"at least {self.least}")
        if self.most is not None:
            limits.append(f"at most {self.most}")
        if self.least == self.most:
            limits = [f"exactly {self.most}"]
        available = int(self.members.sum())
        return f'{" and ".join(limits)} of "{self.name}" ({available} candidates)'


def equal_numbers(groups: Sequence[str], size: int) -> tuple[Quota, ...]:
    """Quotas that share `size` among groups (C,). Raises ValueError if uneven."""
    names = list(dict.fromkeys(groups))
    each, remainder = divmod(size, len(names))
    if remainder:
        below, above = each * len(names), (each + 1) * len(names)
        proposals = f"{below} or {above}" if below else f"{above}"
        raise ValueError(
            f"{size} cannot be shared equally among {len(names)}: ask for {proposals}"
        )
    labels = np.array(groups)
    return tuple(Quota(name, labels == name, each, each) for name in names)


@dataclasses.dataclass(frozen=True, eq=False)
class QuotaSet:
    """Quotas that a plan of `size` candidates keeps together."""

    quotas: tuple[Quota, ...]
    size: int

    def joined(
        self, name: str, members: Mask, least: int = 0, most: int | None = None
    ) -> "QuotaSet":
        """The quotas with one more, as `Quota` has it."""
        quotas = (*self.quotas, Quota(name, members, least, most))
        return dataclasses.replace(self, quotas=quotas)

    def joined_equally(self, groups: Sequence[str]) -> "QuotaSet":
        """Quotas with equal numbers of groups (C,). Raises ValueError."""
        equal = equal_numbers(groups, self.size)
        return dataclasses.replace(self, quotas=(*self.quotas, *equal))

    @functools.cached_property
    def members(self) -> Array:
        """(Q, C) membership, 0 or 1."""
        return np.array([quota.members for quota in self.quotas], dtype=float)

    @functools.cached_property
    def least(self) -> Array:
        """(Q,) least numbers."""
        return np.array([quota.least for quota in self.quotas], dtype=float)

    @functools.cached_property
    def most(self) -> Array:
        """(Q,) largest numbers."""
        largest = [q.most if q.most is not None else self.size for q in self.quotas]
        return np.array(largest, dtype=float)

    @functools.cached_property
    def _classes(self) -> tuple[Array, Index]:
        """Membership (Q, G) of each class, and class (C,) of each candidate."""
        pattern, label = np.unique(self.members, axis=1, return_inverse=True)
        return pattern, label.reshape(-1)

    @property
    def label(self) -> Index:
        """(C,) class of each candidate."""
        return self._classes[1]

    def class_sums(self, weights: Array) -> Array:
        """(G,) sum of weights (C,) in each class."""
        count = self._classes[0].shape[1]
        return np.asarray(np.bincount(self.label, weights, count), dtype=float)

    def class_counts(self, chosen: Index) -> Array:
        """(G,) number of chosen candidates in each class."""
        indicator = np.zeros(self.members.shape[1])
        indicator[chosen] = 1.0
        return self.class_sums(indicator)

    def counts(self, chosen: Index) -> Array:
        """(Q,) number of chosen candidates in each selection."""
        return np.asarray(self.members[:, chosen].sum(axis=1))

    def satisfied(self, chosen: Index) -> bool:
        """Whether a plan is complete and keeps all quotas."""
        counts = self.counts(chosen)
        within = (counts >= self.least).all() and (counts <= self.most).all()
        return len(chosen) == self.size and bool(within)

    def additions(self, chosen: Index) -> Mask:
        """Candidates (C,) that exceed no largest number when added."""
        after = self.counts(chosen)[:, None] + self.members
        return np.asarray((after <= self.most[:, None]).all(axis=0))

    def replacements(self, remaining: Index, removed: int) -> Mask:
        """Candidates (C,) that may take the place of a removed one.

        No count falls below its least number, or below where it was if that is less.
        """
        counts = self.counts(remaining)
        before = counts + self.members[:, removed]
        after = counts[:, None] + self.members
        floor = np.minimum(self.least, before)[:, None]
        return np.asarray((after >= floor).all(axis=0)) & self.additions(remaining)

    def open_classes(self, chosen: Index, allocation: Array) -> Mask:
        """Candidates (C,) of classes with fewer chosen than `allocation` (G,)."""
        return (allocation > self.class_counts(chosen))[self.label]

    def allocate(self, target: Array, chosen: Index | None = None) -> Array | None:
        """Numbers (G,) nearest to a target that keep the quotas, or None."""
        taken = np.zeros(len(target))
        if chosen is not None:
            taken = self.class_counts(chosen)
        return self._allocate(target, taken, range(len(self.quotas)))

    def _allocate(
        self, target: Array, taken: Array, active: Sequence[int]
    ) -> Array | None:
        """`allocate` under some of the quotas only."""
        pattern, _ = self._classes
        count, rows = len(target), list(active)
        available = self.class_sums(np.ones(self.members.shape[1]))
        if (taken > available).any():
            return None
        # variables: the numbers, and how far they are above and below the target
        one, none = np.eye(count), np.zeros((len(rows), 2 * count))
        total = np.repeat([1.0, 0.0], [count, 2 * count])[None]
        distance = np.hstack([one, -one, one])
        constraints = [
            scipy.optimize.LinearConstraint(total, self.size, self.size),
            scipy.optimize.LinearConstraint(distance, target, target),
        ]
        if rows:
            limits = self.least[rows], self.most[rows]
            counts = np.hstack([pattern[rows], none])
            constraints.append(scipy.optimize.LinearConstraint(counts, *limits))
        zeros, unlimited = np.zeros(2 * count), np.full(2 * count, np.inf)
        solution = scipy.optimize.milp(
            c=np.repeat([0.0, 1.0], [count, 2 * count]),
            constraints=constraints,
            integrality=np.repeat([1, 0], [count, 2 * count]),
            bounds=scipy.optimize.Bounds(
                np.append(taken, zeros), np.append(available, unlimited)
            ),
            options={"presolve": False},  # presolve fails in one problem of 1500
        )
        if solution.x is None:
            return None
        return np.asarray(np.round(solution.x[:count]))

    def conflict(self) -> tuple[int, ...] | None:
        """Quotas that cannot be kept together: removing any one of them would do.

        None where all can be kept. Empty where not even the size can.
        """
        target = np.zeros(self._classes[0].shape[1])
        active = list(range(len(self.quotas)))
        if self._allocate(target, target, active) is not None:
            return None
        for index in range(len(self.quotas)):
            others = [k for k in active if k != index]
            if self._allocate(target, target, others) is None:
                active = others
        return tuple(active)

    def linear_limits(self) -> tuple[Array, Array]:
        """(L, C) rows and (L,) upper: every plan's weights keep rows w <= upper."""
        some_most, some_least = self.most < self.size, self.least > 0
        rows = np.vstack([self.members[some_most], -self.members[some_least]])
        upper = np.concatenate([self.most[some_most], -self.least[some_least]])
        return rows, upper

    def subset(self, pool: Index) -> "QuotaSet":
        """The quotas over a part of the candidates."""
        quotas = tuple(
            dataclasses.replace(quota, members=quota.members[pool])
            for quota in self.quotas
        )
        return QuotaSet(quotas, self.size)
