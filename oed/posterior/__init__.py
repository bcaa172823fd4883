"""The posterior of the parameters: log density, sampling, checks of the sampler."""

from oed.posterior.posterior import Posterior, sample, to_arviz

__all__ = ["Posterior", "sample", "to_arviz"]
