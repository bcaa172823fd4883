"""The true covariance of readings in place of an estimated noise law."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.gap import GapProblem
from oed.noise import Errors, NoiseLaw, ReadingStructure


@dataclasses.dataclass(frozen=True, eq=False)
class TrueLaw(NoiseLaw):
    """The true covariance of the readings in place of a law's."""

    #: (N, N) in units of the stated noise
    true: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))

    def errors(self, structure: ReadingStructure, rows: Index | None = None) -> Errors:
        """As in `NoiseLaw`: half the least variance of each segment, and what it shares."""
        segments = list(structure.members)
        if rows is not None:
            segments = [s[np.isin(s, rows)] for s in segments]
            segments = [s for s in segments if s.size]
        order = np.concatenate(segments)
        ends = np.cumsum([len(s) for s in segments])
        starts = np.append(0, ends[:-1])
        shared = np.zeros((len(order), int(np.diff(ends, prepend=0).max())))
        single = np.empty(len(order))
        for start, end, members in zip(starts, ends, segments, strict=True):
            values, axes = np.linalg.eigh(self.true[np.ix_(members, members)])
            single[start:end] = 0.5 * values[0]
            roots = np.sqrt(values - 0.5 * values[0])
            shared[start:end, : end - start] = axes * roots
        nothing = np.zeros(len(order))
        return Errors(
            order=order,
            starts=starts,
            decay=nothing,
            single=single,
            correlated=nothing,
            shared=shared,
            scale=np.ones(len(order)),
        )


def true_law(problem: GapProblem, sigma: Array) -> TrueLaw:
    """The law of a covariance (N, N), SI.

    Raises ValueError where it relates readings of different runs.
    """
    covariance = sigma / np.outer(problem.sigma, problem.sigma)
    across = covariance.copy()
    for members in problem.members:
        across[np.ix_(members, members)] = 0.0
    if float(np.abs(across).max(initial=0.0)) > 1e-9:
        raise ValueError(
            "the true noise relates readings of different runs; the law of a diagnosis"
            " cannot"
        )
    return TrueLaw(problem.stated_law.law, true=covariance)
