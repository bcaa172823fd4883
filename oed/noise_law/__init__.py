"""Which noise law readings have: its prior, evidence and posterior; outliers.

KNOWN_TO            factor to which a stated noise is good
MIN_FREEDOM         degrees of freedom from which readings determine their noise law
KernelMixture       Student t kernels at laws
NoisePosterior      the posterior of a law, as weighted draws
NoisePrior          the prior of laws, given what is stated of the noise
Outliers            readings far off, and residuals that replace theirs
ResidualModel       residuals as a linear model: evidence of laws, most probable law
densities_over_scales  of errors, with tails and scales of their noise
detect_outliers     readings that all others contradict
draw_laws           draws laws by a cost
log_prior_of_scale  log prior density of the noise over the stated one
robust_residuals    residuals with those far off replaced
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.noise_law.marginal import (
        KernelMixture,
        NoisePosterior,
        ResidualModel,
        draw_laws,
    )
    from oed.noise_law.outliers import (
        Outliers,
        densities_over_scales,
        detect_outliers,
        robust_residuals,
    )
    from oed.noise_law.prior import (
        KNOWN_TO,
        MIN_FREEDOM,
        NoisePrior,
        log_prior_of_scale,
    )
else:
    __getattr__ = door(__name__)
