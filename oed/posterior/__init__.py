"""The posterior of the parameters: log density, sampling, checks of the sampler."""

from oed.posterior.laplace import draw_approximation
from oed.posterior.log_density import LogDensity
from oed.posterior.posterior import Posterior, sample, to_arviz
from oed.posterior.posterior_checks import predictive_checks

__all__ = [
    "LogDensity",
    "Posterior",
    "draw_approximation",
    "predictive_checks",
    "sample",
    "to_arviz",
]
