"""The posterior of the parameters: log density, sampling, checks of the sampler."""

from oed.posterior.posterior import Posterior, sample

__all__ = ["Posterior", "sample"]
