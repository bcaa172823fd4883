"""What effects that the model lacks can do to the readings.

A reading is geometry + effects + noise (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63,
425-464; Brynjarsdottir and O'Hagan 2014, Inverse Problems 30, 114007). The effects change
the readings by G b. The coefficients b of a group (an effect in one leg) have a common
size t_g: b ~ N(0, t_g^2), in expected sizes of the effect. Sizes have a prior with heavy
tails and are drawn with the coefficients (`oed.estimation.effect_sizes`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array, Index, Mask
from oed.noise.covariance import Noise


@dataclasses.dataclass(frozen=True, eq=False)
class Discrepancy:
    """Changes of the readings by effects that the model lacks.

    columns  (N, k) change of the readings per expected size of each coefficient, SI
    group    (k,) number of the group of each coefficient
    names    (g,) of the groups, `effect` or `effect: block`
    unknown  (g,) which groups stand for effects of no known form
    """

    columns: Array
    group: Index
    names: tuple[str, ...]
    unknown: Mask

    def members(self) -> list[Index]:
        """Numbers of the coefficients of each group."""
        return [np.flatnonzero(self.group == g) for g in range(len(self.names))]


@dataclasses.dataclass(frozen=True, eq=False)
class SampledEffects:
    """Draws of effects, together with the parameters.

    discrepancy   what was fitted
    coefficients  (m, k) draws, in expected sizes
    sizes         (m, g) draws of the sizes of the groups, in expected sizes
    theta         (m, n) draws of the parameters, SI, that belong to them; directions that
                  no reading determines are nominal
    faulty        probability that an effect is present, beyond those that are as small as
                  all of this machine are
    """

    discrepancy: Discrepancy
    coefficients: Array
    sizes: Array
    theta: Array
    faulty: float

    @property
    def rms_sizes(self) -> Array:
        """Root mean square (g,) of the sizes of each group over the draws."""
        return np.asarray(np.sqrt((self.sizes**2).mean(axis=0)))

    @property
    def changes(self) -> Array:
        """Mean change (N,) of the readings by all effects, SI."""
        return np.asarray(self.discrepancy.columns @ self.coefficients.mean(axis=0))

    def freedom(self, noise: Noise, jacobian: Array) -> float:
        """Degrees of freedom that parameters and effects take from the readings.

        By what the sum of squares of draws is above that of their mean, whitened by the
        noise. jacobian (N, n) is that of the readings.
        """
        of_theta = jacobian @ (self.theta - self.theta.mean(axis=0)).T
        offsets = self.coefficients - self.coefficients.mean(axis=0)
        white = noise.whiten(of_theta + self.discrepancy.columns @ offsets.T)
        return float((white**2).sum() / len(offsets))
