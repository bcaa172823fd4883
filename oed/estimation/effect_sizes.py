"""Coefficients and sizes of effects, drawn by tempered Gibbs sampling.

With the parameters integrated out, the log likelihood of the coefficients b is that of
a linear model, b^T s - b^T J b / 2. The prior:

- A machine has a common size c, and each group of coefficients is about that small:
  t_g = c times 0.1 to 1. A good machine has all of its effects small, a worn one not.
- A faulty machine has single effects beside: with a probability each, a group is as large
  as catalogues state, or many times larger.

Whether the machine is faulty, c, all t_g and all b are drawn in turn (Gibbs). Particles
begin at the prior and are brought to the posterior by a likelihood to a power that rises
from 0 to 1 (sequential Monte Carlo; Del Moral, Doucet and Jasra 2006, J. R. Stat. Soc. B
68, 411-436), which also gives the evidence.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import optimize, special

from oed.base.arrays import Array, Index, Mask

#: sizes of groups, in expected sizes: two a decade
SIZES = 10.0 ** (np.arange(-7, 9) / 2.0)
#: common sizes, as numbers of SIZES: 10^-2.5 to 10^0.5, alike probable
COMMON = np.arange(2, 9)
#: sizes of single groups over the common one, in steps of SIZES, and their shares
NEAR, NEAR_SHARES = np.arange(-2, 2), np.array([0.15, 0.25, 0.35, 0.25])
#: sizes of effects that are present, 10^-1 to 10^4, as numbers of SIZES; shares
PRESENT = np.arange(5, 16)
PRESENT_SHARES = np.array(
    [0.08, 0.16, 0.25, 0.20, 0.12, 0.07, 0.05, 0.03, 0.02, 0.01, 0.01]
)
#: probability that a group is present in a faulty machine: of known form, of unknown form
KNOWN, UNKNOWN = 0.15, 0.3
#: effective share of the particles that a step of the power keeps
KEPT = 0.5
#: sweeps over all groups after each step of the power
SWEEPS = 2


@dataclasses.dataclass(frozen=True, eq=False)
class EffectDraws:
    """m draws from the posterior of effects.

    coefficients  (m, k)
    sizes         (m, g) of the groups
    faulty        (m,) whether the machine is faulty
    log_evidence  of the readings, over that without effects
    """

    coefficients: Array
    sizes: Array
    faulty: Mask
    log_evidence: float


def sample(
    information: Array,
    score: Array,
    members: list[Index],
    unknown: Mask,
    rng: np.random.Generator,
    count: int,
    final: int = 10,
) -> EffectDraws:
    """Draw `count` sets of coefficients and sizes.

    information  (k, k) J of the coefficients, the parameters integrated out
    score        (k,) s
    members      coefficients of each group
    unknown      (g,) which groups have no known form
    final        sweeps at the posterior
    """
    sampler = _Sampler(information, score, members, unknown, rng)
    particles = sampler.prior(count)
    power, log_evidence = 0.0, 0.0
    while power < 1.0:
        log_likelihood = sampler.log_likelihood(particles.coefficients)
        step = _next_step(log_likelihood, 1.0 - power)
        log_weights = step * log_likelihood
        log_evidence += float(special.logsumexp(log_weights)) - np.log(count)
        particles = particles.take(_systematic(special.softmax(log_weights), rng))
        power = min(power + step, 1.0)
        for _ in range(SWEEPS):
            particles = sampler.sweep(particles, power)
    for _ in range(final):
        particles = sampler.sweep(particles, 1.0)
    return EffectDraws(
        coefficients=particles.coefficients,
        sizes=SIZES[particles.size],
        faulty=particles.state >= len(COMMON),
        log_evidence=log_evidence,
    )


def log_prior(unknown: Mask) -> Array:
    """Log probabilities (g, states, sizes) of each group's size.

    The states are the common sizes of healthy machines, then those of faulty ones.
    """
    healthy = np.zeros((len(COMMON), len(SIZES)))
    for row, common in enumerate(COMMON):
        healthy[row, common + NEAR] = NEAR_SHARES
    stated = np.zeros(len(SIZES))
    stated[PRESENT] = PRESENT_SHARES / PRESENT_SHARES.sum()
    tables = []
    for is_unknown in unknown:
        share = UNKNOWN if is_unknown else KNOWN
        faulty = (1.0 - share) * healthy + share * stated
        tables.append(np.vstack([healthy, faulty]))
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(np.array(tables)))


def healthy_size() -> float:
    """Geometric mean of the sizes of a healthy machine's groups, in expected sizes."""
    common = np.log(SIZES[COMMON]).mean()
    near = np.log(SIZES[1] / SIZES[0]) * (NEAR_SHARES @ NEAR)
    return float(np.exp(common + near))


@dataclasses.dataclass(frozen=True, eq=False)
class _Particles:
    """m particles: coefficients (m, k), numbers of the sizes (m, g) and states (m,)."""

    coefficients: Array
    size: Index
    state: Index

    def take(self, rows: Index) -> _Particles:
        return _Particles(self.coefficients[rows], self.size[rows], self.state[rows])


class _Sampler:
    """Conditional draws of a linear model's coefficients and sizes."""

    def __init__(
        self,
        information: Array,
        score: Array,
        members: list[Index],
        unknown: Mask,
        rng: np.random.Generator,
    ) -> None:
        self._information, self._score = information, score
        self._members, self._rng = members, rng
        self._log_prior = log_prior(unknown)
        self._axes, self._rows = [], []
        self._group = np.zeros(len(score), dtype=np.intp)
        for g, rows in enumerate(members):
            self._group[rows] = g
            self._rows.append(information[rows])
            values, vectors = np.linalg.eigh(self._rows[g][:, rows])
            self._axes.append((np.maximum(values, 0.0), vectors))

    def prior(self, count: int) -> _Particles:
        """Particles of the prior."""
        state = self._rng.integers(self._log_prior.shape[1], size=count)
        drawn = [self._drawn(table[state]) for table in self._log_prior]
        size = np.column_stack(drawn)
        normal = self._rng.standard_normal((count, len(self._score)))
        return _Particles(normal * SIZES[size][:, self._group], size, state)

    def log_likelihood(self, b: Array) -> Array:
        """Log likelihood (m,) of coefficients (m, k)."""
        square = np.einsum("mk,mk->m", b @ self._information, b)
        return np.asarray(b @ self._score - 0.5 * square)

    def sweep(self, particles: _Particles, power: float) -> _Particles:
        """All groups, in a drawn order, then the states, given the rest."""
        b, size = particles.coefficients.copy(), particles.size.copy()
        state = particles.state
        for g in self._rng.permutation(len(self._members)):
            self._draw_group(g, b, size, state, power)
        total = np.zeros((len(b), self._log_prior.shape[1]))
        for g, table in enumerate(self._log_prior):
            total += table.T[size[:, g]]
        return _Particles(b, size, self._drawn(total))

    def _draw_group(
        self, g: int, b: Array, size: Index, state: Index, power: float
    ) -> None:
        """Size and coefficients of group g, in place: first the size, b_g integrated out."""
        rows = self._members[g]
        values, vectors = self._axes[g]
        others = b.copy()
        others[:, rows] = 0.0
        score = self._score[rows] - others @ self._rows[g].T
        along = score @ vectors
        squares = SIZES[:, None] ** 2
        widened = 1.0 + power * values * squares
        gain = (power**2 * squares / widened) @ (along**2).T
        evidence = 0.5 * (gain.T - np.log(widened).sum(axis=1))
        drawn = self._drawn(evidence + self._log_prior[g][state])
        size[:, g] = drawn
        variance = 1.0 / (power * values + SIZES[drawn][:, None] ** -2.0)
        normal = self._rng.standard_normal(along.shape)
        b[:, rows] = (variance * power * along + np.sqrt(variance) * normal) @ vectors.T

    def _drawn(self, log_weights: Array) -> Index:
        """One column (m,) of each row (m, n) of log weights (Gumbel's maximum)."""
        noise = self._rng.gumbel(size=log_weights.shape)
        return np.asarray(np.argmax(log_weights + noise, axis=1), dtype=np.intp)


def _next_step(log_likelihood: Array, largest: float) -> float:
    """The step of the power that keeps a share of the particles effective."""
    wanted = KEPT * len(log_likelihood)

    def excess(step: float) -> float:
        weights = special.softmax(step * log_likelihood)
        return 1.0 / float((weights**2).sum()) - wanted

    if excess(largest) >= 0.0:
        return largest
    return float(optimize.brentq(excess, 0.0, largest, xtol=1e-12))


def _systematic(weights: Array, rng: np.random.Generator) -> Index:
    """Numbers (m,) of particles, drawn by their weights with one random number."""
    count = len(weights)
    places = (np.arange(count) + rng.random()) / count
    number = np.searchsorted(np.cumsum(weights), places)
    return np.asarray(np.minimum(number, count - 1), dtype=np.intp)
