"""What effects that the model lacks can do to the readings.

A reading is geometry + effects + noise (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63,
425-464; Brynjarsdottir and O'Hagan 2014, Inverse Problems 30, 114007). The effects change
the readings by G b. All coefficients have a common size t: b ~ N(0, t^2), in expected sizes
of their effects, which is drawn with them (`oed.estimation.effect_sizes`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array, Index, Mask
from oed.estimation.effect_sizes import SMALL
from oed.noise.covariance import Noise


@dataclasses.dataclass(frozen=True, eq=False)
class Discrepancy:
    """Changes of the readings by effects that the model lacks.

    columns  (N, k) change of the readings per expected size of each coefficient, SI
    group    (k,) number of the group of each coefficient
    names    (g,) of the groups, `effect` or `effect: block`
    unknown  (g,) which groups stand for effects of no known form
    sizes    (t,) common sizes that are possible, in expected sizes
    """

    columns: Array
    group: Index
    names: tuple[str, ...]
    unknown: Mask
    sizes: Array = dataclasses.field(default_factory=lambda: SMALL)

    @property
    def is_small(self) -> bool:
        """Whether the effects are those of a machine in order."""
        return bool(self.sizes.max() <= SMALL[-1])


@dataclasses.dataclass(frozen=True, eq=False)
class SampledEffects:
    """Draws of effects, together with the parameters.

    discrepancy   what was fitted
    coefficients  (m, k) draws, in expected sizes
    size          (m,) draws of the common size, in expected sizes
    theta         (m, n) draws of the parameters, SI, that belong to them; directions that
                  no reading determines are nominal
    log_evidence  of the readings with effects, over that without
    """

    discrepancy: Discrepancy
    coefficients: Array
    size: Array
    theta: Array
    log_evidence: float

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
