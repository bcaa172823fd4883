"""Coefficients of effects of one common size, drawn in closed form.

With the parameters integrated out, the log likelihood of the coefficients b is that of
a linear model, b^T s - b^T J b / 2. All effects of a healthy machine are about as small as
each other: b ~ N(0, t^2), in expected sizes, of a common t that the evidence decides,

    2 log p(r | t) - 2 log p(r | 0) = -log |1 + t^2 J| + s^T (t^-2 + J)^-1 s.

Effects that stand out are hypotheses of a diagnosis (`oed.gap`), and no part of these.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.base.linear_algebra import explained_energy

#: typical size of a healthy machine's effects, in expected sizes, which are those of
#: catalogues: a machine in order has 0.07 of them
HEALTHY = 10.0**-1.15
#: sizes of a healthy machine's effects: two a decade, alike probable
SMALL = HEALTHY * 10.0 ** (np.arange(-3, 4) / 2.0)
#: sizes of what stands out, of unknown form
LARGE = 10.0 ** (np.arange(-2, 9) / 2.0)
#: energy of a direction over the largest that is rounding
ROUNDING = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class EffectDraws:
    """m draws from the posterior of effects.

    coefficients  (m, k)
    size          (m,) common sizes
    log_evidence  of the readings, over that without effects
    """

    coefficients: Array
    size: Array
    log_evidence: float


def sample(
    information: Array,
    score: Array,
    sizes: Array,
    rng: np.random.Generator,
    count: int,
) -> EffectDraws:
    """Draw `count` sets of coefficients, each with its common size.

    information  (k, k) J of the coefficients, the parameters integrated out
    score        (k,) s
    sizes        (t,) that are possible, alike probable
    """
    energy, axes = np.linalg.eigh(information)
    energy = np.where(energy > ROUNDING * energy.max(initial=0.0), energy, 0.0)
    along = np.where(energy > 0.0, score @ axes, 0.0)
    gain, log_determinant = explained_energy(energy, along**2, sizes**2)
    log_weights = 0.5 * (gain - log_determinant)
    precision = sizes[:, None] ** -2.0 + energy
    number = rng.choice(len(sizes), size=count, p=special.softmax(log_weights))
    normal = rng.standard_normal((count, len(score)))
    drawn = along / precision[number] + normal / np.sqrt(precision[number])
    return EffectDraws(
        coefficients=drawn @ axes.T,
        size=sizes[number],
        log_evidence=float(special.logsumexp(log_weights) - np.log(len(sizes))),
    )
