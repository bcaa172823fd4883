"""Parameters after a diagnosis: the mixture over its answers.

With P_a the probability of answer a (no gap, each set of effects, these beside small
effects, something of no known form) and p(theta, b | a) the posterior of parameters and
coefficients if it is right, what is known of the machine is

    p(theta, b) = sum_a P_a p(theta, b | a).

Its mean is that of the answers' means m_a, its covariance what they leave within and
between them, sum_a P_a [C_a + (m_a - m)(m_a - m)^T] (Hoeting, Madigan, Raftery and
Volinsky 1999, Stat. Sci. 14, 382-401). Each answer's posterior is that of the one fitter.
In a draw of one answer the effects of all others are 0.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index
from oed.effects import ExpectedColumns
from oed.estimation import Estimate

#: draws of the mixture: each answer has as many as its share of them
DRAWS = 2000


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerPosterior:
    """What is known of the machine if one answer of a diagnosis is right.

    effects       as the diagnosis names them; none: no gap
    unseen        whether small effects of one common size act as well
    probability   of the answer, by the diagnosis
    mean          (n,) parameters, SI
    covariance    (n, n) of the parameters
    theta         (m, n) draws of the parameters, SI
    estimate      the fit; its theta has coefficients of named effects after the parameters
    noise_law     (m, d) draws of the law's coordinates, one for each of the parameters
    columns       of what acts beside the parameters; None where nothing does
    coefficients  (m, k) draws of what acts, one for each draw of the parameters
    """

    effects: tuple[str, ...]
    unseen: bool
    probability: float
    mean: Array
    covariance: Array
    theta: Array
    estimate: Estimate
    noise_law: Array
    columns: ExpectedColumns | None = None
    coefficients: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerMixture:
    """What is known of the machine after a diagnosis.

    answers   those that were fitted, the decision's first
    rest      probability of all others
    """

    answers: tuple[AnswerPosterior, ...]
    rest: float

    @functools.cached_property
    def shares(self) -> Array:
        """Probabilities (a,) of the answers among those that were fitted."""
        probabilities = np.array([a.probability for a in self.answers])
        return np.asarray(probabilities / probabilities.sum())

    @functools.cached_property
    def mean(self) -> Array:
        """Mean parameters (n,), SI."""
        return np.asarray(self.shares @ np.array([a.mean for a in self.answers]))

    @functools.cached_property
    def covariance(self) -> Array:
        """Covariance (n, n) of the parameters, within and between the answers."""
        total = np.zeros((len(self.mean), len(self.mean)))
        for share, answer in zip(self.shares, self.answers, strict=True):
            offset = answer.mean - self.mean
            total += share * (answer.covariance + np.outer(offset, offset))
        return total

    def quantiles(self, levels: Sequence[float]) -> Array:
        """Quantiles (levels, n) of each parameter, by the draws in their shares."""
        theta = np.vstack([a.theta for a in self.answers])
        weights = np.concatenate(
            [
                np.full(len(a.theta), share / len(a.theta))
                for share, a in zip(self.shares, self.answers, strict=True)
            ]
        )
        order = np.argsort(theta, axis=0, kind="stable")
        values = np.take_along_axis(theta, order, axis=0)
        reached = np.cumsum(weights[order], axis=0) - 0.5 * weights[order]
        columns = range(theta.shape[1])
        return np.column_stack(
            [np.interp(levels, reached[:, k], values[:, k]) for k in columns]
        )

    def rows(self, rng: np.random.Generator, count: int = DRAWS) -> list[Index]:
        """Numbers of draws of each answer: `count` in all, in the answers' shares."""
        edges = np.round(np.concatenate([[0.0], np.cumsum(self.shares)]) * count)
        counts = np.diff(edges).astype(int)
        return [
            rng.permutation(np.arange(max(n, len(a.theta))) % len(a.theta))[:n]
            for a, n in zip(self.answers, counts, strict=True)
        ]

    def draw(self, rng: np.random.Generator, count: int = DRAWS) -> MixtureDraws:
        """Draws of the machine: answers in their shares, each with its effects."""
        taken = self.rows(rng, count)
        counts = np.array([len(rows) for rows in taken])
        theta = [a.theta[rows] for a, rows in zip(self.answers, taken, strict=True)]
        acting = [
            (k, a.columns) for k, a in enumerate(self.answers) if a.columns is not None
        ]
        widths = [columns.mixing.shape[1] for _, columns in acting]
        ends = np.concatenate([[0], np.cumsum(widths)]).astype(int)
        coefficients = np.zeros((count, ends[-1]))
        starts = np.concatenate([[0], np.cumsum(counts)])
        for number, (k, _) in enumerate(acting):
            rows = slice(starts[k], starts[k + 1])
            block = slice(ends[number], ends[number + 1])
            coefficients[rows, block] = self.answers[k].coefficients[taken[k]]
        return MixtureDraws(
            np.vstack(theta),
            np.repeat(np.arange(len(self.answers)), counts),
            ExpectedColumns.side_by_side([columns for _, columns in acting]),
            coefficients,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class MixtureDraws:
    """Draws of the machine after a diagnosis.

    theta         (m, n) parameters, SI
    answer        (m,) number of the answer that each belongs to
    columns       of all effects of all answers; None where nothing acts in any
    coefficients  (m, k) of them
    """

    theta: Array
    answer: Index
    columns: ExpectedColumns | None
    coefficients: Array
