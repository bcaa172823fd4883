"""Noise of four laws, drawn here: unit errors of chains of readings.

A chain is one source of error (a channel) along one run. All laws state their standard
deviation, but for the offsets of runs, which no study states.

white       independent normal errors
along       half to nine tenths of the variance is carried along the run, exponentially
            over 3 to 12 readings
offsets     white, and each chain off by a normal error of 0.5 to 3
tails       independent Student t errors of 4 degrees of freedom
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

Array = np.ndarray
LAWS = ("white", "along", "offsets", "tails")


@dataclasses.dataclass(frozen=True)
class Law:
    """A law with its numbers: share and reach of what is carried, offsets of runs."""

    name: str
    share: float
    reach: float
    offset: float

    def chain(self, count: int, rng: np.random.Generator) -> Array:
        """Errors (count,) of one chain."""
        normal = rng.standard_normal(count)
        if self.name == "white":
            return normal
        if self.name == "tails":
            return np.asarray(rng.standard_t(4.0, count) / math.sqrt(2.0))
        if self.name == "offsets":
            return np.asarray(normal + self.offset * rng.standard_normal())
        keep = math.exp(-1.0 / self.reach)
        carried = rng.standard_normal(count)
        for k in range(1, count):
            fresh = math.sqrt(1.0 - keep**2) * carried[k]
            carried[k] = keep * carried[k - 1] + fresh
        slow, fast = math.sqrt(self.share), math.sqrt(1.0 - self.share)
        return np.asarray(slow * carried + fast * normal)


def draw(name: str, rng: np.random.Generator) -> Law:
    """A law of LAWS with random numbers."""
    share, reach, offset = rng.uniform((0.5, 3.0, 0.5), (0.9, 12.0, 3.0))
    return Law(name, float(share), float(reach), float(offset))
