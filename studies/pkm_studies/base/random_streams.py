"""Random numbers of a study, a stream for each purpose; and progress of long work."""

import enum
from typing import Protocol

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


class Progress(Protocol):
    """What a pipeline reports: the stage that begins, and the share that is done."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def share(self, done: float) -> None:
        """The share (0..1) of the present stage that is done."""


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str) -> None:
        """Ignore the stage."""

    def share(self, done: float) -> None:
        """Ignore the share."""
