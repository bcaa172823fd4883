"""What is known of the noise before the readings: a prior over its laws.

The stated noise is the anchor: single readings scatter by it within a factor exp(0.4).
A data sheet tells of repeatability within a run; what a run shares and what is carried
along are stated by no data sheet, so their priors are wide and reach down to nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import special

from oed.arrays import Array
from oed.noise.process import RENEWED, Laws
from oed.noise.structure import ReadingStructure

#: sd of the log of a group's noise over the stated one, and sd from which on its tails
#: are heavy: at four it is not 5 times the stated noise but 25 times
SCALE_SD, HEAVY_FROM = 0.4, 4.0
#: distance of the share that is carried along from 0 and 1, for the filter's sake
LEAST_SHARE = 1e-6
#: median of the share that is mostly small, and sd of its logit
SMALL_SHARE, SMALL_SHARE_SD = 0.05, 2.5
#: median of the reach, in readings, and sd of its log
REACH_MEDIAN, REACH_SD = 8.0, 1.0

#: names of the coordinates that all readings have, and of that of renewed unknowns
COMMON, SEAT = ("share carried along", "reach", "level of a run"), ("seating",)


@dataclasses.dataclass(frozen=True, slots=True)
class Amounts:
    """How large the parts of the noise are that no data sheet states.

    shared_median, shared_sd  median, in units of the stated noise, of a run's level and
                              of a renewed unknown, and sd of their logs
    carried                   share (L,) of the variance that is carried along, of
                              normal coordinates (L,)
    """

    shared_median: float
    shared_sd: float
    carried: Callable[[Array], Array]


def _share(u: Array) -> Array:
    """A share between 0 and 1 of normal coordinates, by the arcsine law.

    It is Jeffreys' prior of a share: all is carried along, nothing is, or anything
    between. A prior about a middle value made the intervals too narrow where all is.
    """
    share = np.sin(0.5 * np.pi * special.ndtr(u)) ** 2
    return np.asarray(np.clip(share, LEAST_SHARE, 1.0 - LEAST_SHARE))


def _small_share(u: Array) -> Array:
    """A share between 0 and 1 that is mostly small: its logit is normal."""
    middle = special.logit(SMALL_SHARE)
    return np.asarray(special.expit(middle + SMALL_SHARE_SD * u))


#: for estimates, where what is forgotten makes intervals too narrow: from a thirtieth of
#: the noise to five times it
CAUTIOUS = Amounts(0.4, 1.3, _share)
#: for questions of cause, where what is assumed hides a gap: each part may as well be
#: absent, two in five are below a tenth of the noise, one in seven exceeds it
SPARSE = Amounts(0.15, 1.8, _small_share)


@dataclasses.dataclass(frozen=True)
class NoisePrior:
    """A prior over laws: coordinates u (d,) are standard normal.

    names     of the coordinates
    groups    number of groups with a scale of their own
    has_seat  whether runs seat an unknown anew
    amounts   of what no data sheet states
    """

    names: tuple[str, ...]
    groups: int
    has_seat: bool
    amounts: Amounts = CAUTIOUS

    @property
    def dimensions(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    def laws(self, u: Array) -> Laws:
        """Laws at coordinates (L, d)."""
        g, amounts = self.groups, self.amounts
        reach, level = u[:, g + 1], u[:, g + 2]
        seat = np.zeros(len(u))
        if self.has_seat:
            seat = amounts.shared_median * np.exp(amounts.shared_sd * u[:, g + 3])
        return Laws(
            scale=np.exp(SCALE_SD * _heavy(u[:, :g])),
            carried=amounts.carried(u[:, g]),
            reach=REACH_MEDIAN * np.exp(REACH_SD * reach),
            level=amounts.shared_median * np.exp(amounts.shared_sd * level),
            seat=seat,
        )

    def starts(self) -> Array:
        """Coordinates (s, d) from which the most probable law is sought.

        The middle of the prior, an error that is carried far, and one that is carried
        over a few readings alone: each may be a mode of its own.
        """
        starts = np.zeros((3, self.dimensions))
        starts[1, self.groups : self.groups + 2] = 1.5, 0.5
        starts[2, self.groups : self.groups + 2] = 2.5, -1.5
        return starts


def _heavy(u: Array) -> Array:
    """Normal coordinates with a heavier upper tail: noise may be far above a data sheet."""
    return np.asarray(u * (1.0 + (np.maximum(u, 0.0) / HEAVY_FROM) ** 2))


def noise_prior(structure: ReadingStructure) -> NoisePrior:
    """The prior that goes with readings of a structure."""
    has_seat = bool((structure.kinds == RENEWED).any())
    scales = tuple(f"noise of {name}" for name in structure.names)
    seat = SEAT if has_seat else ()
    return NoisePrior((*scales, *COMMON, *seat), len(scales), has_seat)
