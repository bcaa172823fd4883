"""The posterior of the parameters: log density, sampling, checks of the sampler."""
