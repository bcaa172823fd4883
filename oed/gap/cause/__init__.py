"""Which effects act: evidence, posterior over sets of effects, classes, verdict."""
