"""Random numbers of a study: one stream for each purpose, all from the study's seed."""

import enum

import numpy as np


@enum.unique
class Stream(enum.IntEnum):
    """Independent random streams: more draws in one leave the others as they are.

    A seed alone gives the numbers of stream 0, for NumPy takes (seed,) and (seed, 0) as
    one: so whatever draws has a stream of its own.
    """

    DESIGN = 0
    TRUTH = 1
    NOISE = 2
    SAMPLER = 3
    PREDICT = 4
    MACHINES = 5
    HELD_OUT = 6
    PLAN = 7
    CAMPAIGN = 8
    EFFECTS = 9
    GAP = 10
    BEFORE = 11
    CHECKS = 12
    CORRECTED = 13
    ACCEPTANCE = 14
    HISTORY = 15
    PREDICTIVE = 16
    UNMODELLED = 17
    TOOLS = 19
    LAPLACE = 20
    FORECAST = 22
    MIXTURE = 23
    VISIT = 24
    MIXTURE_ACCURACY = 25
    PLANNED_COURSES = 26
    HOW_MANY = 27

    def key(self, seed: int) -> list[int]:
        """What determines the random numbers of this stream."""
        return [seed, int(self)]

    def rng(self, seed: int) -> np.random.Generator:
        """Random numbers of this stream."""
        return np.random.default_rng(self.key(seed))
