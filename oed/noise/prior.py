"""What is known of the noise before the readings: a prior over its laws.

The stated noise is the anchor: single readings scatter by it within a factor exp(0.4).
A data sheet tells of repeatability within a run; what a run shares and what is carried
along are stated by no data sheet, so their priors are wide and reach down to nothing.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import special

from oed.arrays import Array
from oed.noise.process import RENEWED, Laws
from oed.noise.structure import ReadingStructure

#: sd of the log of a group's noise over the stated one, and sd from which on its tails
#: are heavy: at four it is not 5 times the stated noise but 25 times
SCALE_SD, HEAVY_FROM = 0.4, 4.0
#: median, in units of the stated noise, of a run's level and of a renewed unknown, and
#: sd of their logs: from a thirtieth of the noise to five times it
SHARED_MEDIAN, SHARED_SD = 0.4, 1.3
#: distance of the share that is carried along from 0 and 1, for the filter's sake
LEAST_SHARE = 1e-6
#: median of the reach, in readings, and sd of its log
REACH_MEDIAN, REACH_SD = 8.0, 1.0


@dataclasses.dataclass(frozen=True)
class NoisePrior:
    """A prior over laws: coordinates u (d,) are standard normal.

    names     of the coordinates
    groups    number of groups with a scale of their own
    has_seat  whether runs seat an unknown anew
    """

    names: tuple[str, ...]
    groups: int
    has_seat: bool

    @property
    def dimensions(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    def laws(self, u: Array) -> Laws:
        """Laws at coordinates (L, d)."""
        g = self.groups
        reach, level = u[:, g + 1], u[:, g + 2]
        seat = np.zeros(len(u))
        if self.has_seat:
            seat = SHARED_MEDIAN * np.exp(SHARED_SD * u[:, g + 3])
        return Laws(
            scale=np.exp(SCALE_SD * _heavy(u[:, :g])),
            carried=_share(u[:, g]),
            reach=REACH_MEDIAN * np.exp(REACH_SD * reach),
            level=SHARED_MEDIAN * np.exp(SHARED_SD * level),
            seat=seat,
        )

    def starts(self) -> Array:
        """Coordinates (s, d) from which the most probable law is sought.

        The middle of the prior, and an error that is carried far.
        """
        starts = np.zeros((2, self.dimensions))
        starts[1, self.groups : self.groups + 2] = 1.5, 0.5
        return starts


def _heavy(u: Array) -> Array:
    """Normal coordinates with a heavier upper tail: noise may be far above a data sheet."""
    return np.asarray(u * (1.0 + (np.maximum(u, 0.0) / HEAVY_FROM) ** 2))


def _share(u: Array) -> Array:
    """A share between 0 and 1 of normal coordinates, by the arcsine law.

    It is Jeffreys' prior of a share: all is carried along, nothing is, or anything
    between. A prior about a middle value made the intervals too narrow where all is.
    """
    share = np.sin(0.5 * np.pi * special.ndtr(u)) ** 2
    return np.asarray(np.clip(share, LEAST_SHARE, 1.0 - LEAST_SHARE))


def noise_prior(structure: ReadingStructure) -> NoisePrior:
    """The prior that goes with readings of a structure."""
    has_seat = bool((structure.kinds == RENEWED).any())
    scales = tuple(f"noise of {name}" for name in structure.names)
    common = ("share carried along", "reach", "level of a run")
    seat = ("seating",) if has_seat else ()
    return NoisePrior((*scales, *common, *seat), len(scales), has_seat)
