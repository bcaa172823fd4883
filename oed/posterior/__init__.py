"""The posterior of the parameters: log density, sampling, checks of the sampler.

MIXED_RHAT          R-hat of independent ensembles below which they agree
ApproximateDraws    draws from the approximation about an estimate
Checkpoint          where an unfinished chain is saved
LogDensity          log posterior density in identifiable coordinates
OutOfBoundsError    readings and bounds contradict each other
Posterior           draws of the posterior, and their diagnostics
Sampler             the names of samplers
draw_approximation  draws without sampling
draw_coordinates    coordinates of the parameters, the noise law and effects, likewise
predictive_checks   whether readings look like those that the posterior predicts
sample              samples the posterior
save                writes the draws as NetCDF
to_arviz            the draws as ArviZ reads them
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.posterior.chains import MIXED_RHAT, Checkpoint
    from oed.posterior.draws import Posterior, save, to_arviz
    from oed.posterior.log_density import (
        ApproximateDraws,
        LogDensity,
        OutOfBoundsError,
        draw_approximation,
        draw_coordinates,
    )
    from oed.posterior.posterior import Sampler, predictive_checks, sample
else:
    __getattr__ = door(__name__)
