"""What effects that the model lacks can do to the readings.

A reading is geometry + effects + noise (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63,
425-464; Brynjarsdottir and O'Hagan 2014, Inverse Problems 30, 114007). All effects of a
healthy machine are about as small as each other. They change readings by G b, with
b ~ N(0, t^2) in expected sizes, of a common t that is drawn with them. The parameters
integrated out, the log likelihood of b is b^T s - b^T J b / 2, and

    2 log p(r | t) - 2 log p(r | 0) = -log |1 + t^2 J| + s^T (t^-2 + J)^-1 s.

Effects that stand out are hypotheses of a diagnosis (`oed.gap`), and no part of these.
"""

import dataclasses
from typing import ClassVar

import numpy as np
import scipy

from oed.base import Array, Index, Mask
from oed.linear_algebra import explained_energy
from oed.noise import Noise

#: energy of a direction, over the largest, below which it is rounding
ENERGY_TOLERANCE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class EffectDraws:
    """m draws from the posterior of effects."""

    coefficients: Array  #: (m, k)
    size: Array  #: (m,) common sizes
    log_evidence: float  #: of the readings, over that without effects


def sample_effects(
    information: Array, score: Array, sizes: Array, rng: np.random.Generator, count: int
) -> EffectDraws:
    """Draw `count` sets of coefficients, each with its common size of alike `sizes`, by
    information J (k, k), parameters integrated out, and score s (k,).
    """
    energy, axes = np.linalg.eigh(information)
    energy = np.where(energy > ENERGY_TOLERANCE * energy.max(initial=0.0), energy, 0.0)
    along = np.where(energy > 0.0, score @ axes, 0.0)
    gain, log_determinant = explained_energy(energy, along**2, sizes**2)
    log_weights = 0.5 * (gain - log_determinant)
    precision = sizes[:, None] ** -2.0 + energy
    number = rng.choice(len(sizes), size=count, p=scipy.special.softmax(log_weights))
    # as the coefficients have them: axes of equal energy, as of all that no reading
    # shows, are a matter of rounding
    normal = rng.standard_normal((count, len(score))) @ axes
    drawn = along / precision[number] + normal / np.sqrt(precision[number])
    return EffectDraws(
        coefficients=drawn @ axes.T,
        size=sizes[number],
        log_evidence=float(scipy.special.logsumexp(log_weights) - np.log(len(sizes))),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Discrepancy:
    """Changes of the readings by effects that the model lacks."""

    #: typical size of a healthy machine's effects, in expected sizes, which are those of
    #: catalogues: a machine in order has 0.07 of them
    HEALTHY: ClassVar = 10.0**-1.15
    #: sizes of a healthy machine's effects: two a decade, alike probable
    SMALL: ClassVar[Array] = HEALTHY * 10.0 ** (np.arange(-3, 4) / 2.0)
    #: sizes of what stands out, of unknown form
    LARGE: ClassVar[Array] = 10.0 ** (np.arange(-2, 9) / 2.0)

    #: (N, k) change of the readings per expected size of each coefficient, SI
    columns: Array
    group: Index  #: (k,) number of the group of each coefficient
    names: tuple[str, ...]  #: (g,) of the groups, `effect` or `effect: block`
    unknown: Mask  #: (g,) which groups stand for effects of no known form
    #: (t,) common sizes that are possible, in expected sizes
    sizes: Array = dataclasses.field(default_factory=lambda: Discrepancy.SMALL)

    @property
    def is_small(self) -> bool:
        """Whether the effects are those of a machine in order."""
        return bool(self.sizes.max() <= self.SMALL[-1])


@dataclasses.dataclass(frozen=True, eq=False)
class SampledEffects:
    """Draws of effects, together with the parameters."""

    discrepancy: Discrepancy  #: what was fitted
    coefficients: Array  #: (m, k) draws, in expected sizes
    size: Array  #: (m,) draws of the common size, in expected sizes
    #: (m, n) draws of the parameters, SI, that belong to them; directions that no
    #: reading determines are nominal
    theta: Array
    log_evidence: float  #: of the readings with effects, over that without

    @property
    def changes(self) -> Array:
        """Mean change (N,) of the readings by all effects, SI."""
        return np.asarray(self.discrepancy.columns @ self.coefficients.mean(axis=0))

    def freedom(self, noise: Noise, jacobian: Array) -> float:
        """Degrees of freedom that draws take, by squares above those of their mean."""
        of_theta = jacobian @ (self.theta - self.theta.mean(axis=0)).T
        offsets = self.coefficients - self.coefficients.mean(axis=0)
        white = noise.whiten(of_theta + self.discrepancy.columns @ offsets.T)
        return float((white**2).sum() / len(offsets))
