"""What is known of the noise before the readings: a prior over its laws.

The stated noise is the anchor: single readings scatter by it within a factor exp(0.4), or
within a factor of ten where it is an assumption.
A data sheet tells of repeatability within a run. Few state what a run shares and what is
correlated along it; where nothing is stated, their priors are wide and reach down to nothing.
A stated amount is the middle of a narrow prior, and 0 takes the part out of the model.
"""

import dataclasses
from typing import ClassVar

import numpy as np
import scipy

from oed.base import Array
from oed.noise import (
    NOTHING_STATED,
    Laws,
    NoiseStatement,
    ReadingStructure,
    SharedError,
)

#: sd of the log of a group's noise over the stated one: data sheets are good to a half
SCALE_SD = 0.4
#: coordinate from which the tails of a scale are heavy: noise is 25 times the stated one
#: there, and not 5 times
HEAVY_FROM = 4.0
#: least coordinate of a scale, a 170th of the stated noise: readings are rounded there,
#: and sums of squares beside larger effects keep their digits
MIN_COORDINATE = -5.0
#: factor to which a stated noise is good: one standard deviation of that log
KNOWN_TO = float(np.exp(SCALE_SD))
#: sd of that log where the stated noise is an assumption: it may be wrong by a decade
ASSUMED_SCALE_SD = float(np.log(10.0))
#: readings beyond the unknowns, for each group, from which they determine assumed weights
READINGS_PER_WEIGHT = 10
MIN_FREEDOM = 10  #: degrees of freedom from which readings determine their noise law
#: distance of the correlated share from 0 and 1, where the filter is singular
MIN_SHARE = 1e-6
#: median, over the stated noise, of a run's level, of a renewed unknown and of a course,
#: and sd of its log: for estimates, where what is forgotten makes intervals too narrow,
#: from a thirtieth of the noise to five times it
SHARED_MEDIAN = 0.4
SHARED_SD = 1.3
#: the same for questions of cause, where what is assumed hides a gap: two in five are
#: below a tenth of the noise, one in seven exceeds it
SPARSE_MEDIAN = 0.15
SPARSE_SD = 1.8
#: median of the correlated share, and sd of its logit, for questions of cause
SPARSE_SHARE = 0.05
SPARSE_SHARE_SD = 2.5
REACH_SD = 1.0  #: sd of the log of the reach, in readings
#: sd of the logs of a run's level and of its seating over the stated ones
STATED_SD = 0.4
STATED_SHARE_SD = 0.7  #: sd of the logit of the correlated share about the stated one
STATED_REACH_SD = 0.3  #: sd of the log of the reach over the stated one


@dataclasses.dataclass(frozen=True)
class NoisePrior:
    """A prior over laws: coordinates u (d,) are standard normal.

    Constants are the names of coordinates other than scales: of the error that is correlated
    along a run, of what a run shares, of the session's course.
    """

    CORRELATED: ClassVar = "share carried along"
    REACH: ClassVar = "reach"
    RUN: ClassVar = "level of a run"
    SEAT: ClassVar = "seating"
    STATED_RUN: ClassVar = "stated level of a run"
    STATED_SEATING: ClassVar = "stated seating"
    COURSE: ClassVar = "course of the session"

    #: of the coordinates: the scales, then those of the parts of the noise that are in
    #: the model
    names: tuple[str, ...]
    groups: int  #: number of groups of readings with a noise of their own
    statement: NoiseStatement = NOTHING_STATED  #: what is stated
    #: whether all groups have one scale, and weights near the stated ones: with several
    #: groups, each has a factor of its own as of a stated noise
    is_common: bool = False
    #: whether parts that are not stated may as well be absent, as for questions of
    #: cause
    is_sparse: bool = False

    @classmethod
    def of(cls, structure: ReadingStructure, freedom: float = np.inf) -> "NoisePrior":
        """The prior that goes with readings of a structure.

        freedom  readings beyond the unknowns. Where an assumed noise has few for each
                 group, all groups have one scale, and their weights are near the
                 assumed ones. Where a course's terms leave few in all, it is not in the
                 model

        All groups have one correlated share. With one each, a leg whose scale is wrong took
        the weight of a channel: errors at other poses were 1.3 times those of one share.
        """
        statement = structure.statement
        is_few = freedom < READINGS_PER_WEIGHT * len(structure.names)
        is_common = statement.is_assumed and is_few
        groups = len(structure.names)
        scales = structure.names
        if is_common:
            scales = ("all readings", *(scales if groups > 1 else ()))
        correlated = () if statement.correlated == 0.0 else (cls.CORRELATED, cls.REACH)
        of_kind = {
            SharedError.LEVEL: cls.RUN,
            SharedError.RENEWED: cls.SEAT,
            SharedError.STATED_LEVEL: cls.STATED_RUN,
            SharedError.STATED_SEAT: cls.STATED_SEATING,
        }
        shared = tuple(
            name for kind, name in of_kind.items() if kind in structure.kinds
        )
        terms = structure.course.shape[1]
        has_course = terms and freedom - terms >= MIN_FREEDOM
        course = (cls.COURSE,) if has_course else ()
        names = (
            *(f"noise of {name}" for name in scales),
            *correlated,
            *shared,
            *course,
        )
        return cls(names, groups, statement=statement, is_common=is_common)

    @property
    def dimensions(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    def sparse(self) -> "NoisePrior":
        """The prior for questions of cause."""
        return dataclasses.replace(self, is_sparse=True)

    def without(self, name: str) -> "NoisePrior":
        """The prior with a part taken out of the model."""
        names = tuple(n for n in self.names if n != name)
        return dataclasses.replace(self, names=names)

    def laws(self, u: Array) -> Laws:
        """Laws at coordinates (L, d); parts that are not in the model are 0."""
        of_name = dict(zip(self.names, u.T, strict=True))
        nothing, statement = np.zeros(len(u)), self.statement
        reach = of_name.get(self.REACH, nothing)
        reach_sd = REACH_SD if statement.reach is None else STATED_REACH_SD

        def size(name: str) -> Array:
            if name not in of_name:
                return nothing
            median = SPARSE_MEDIAN if self.is_sparse else SHARED_MEDIAN
            sd = SPARSE_SD if self.is_sparse else SHARED_SD
            return np.asarray(median * np.exp(sd * of_name[name]))

        def factor(name: str) -> Array:
            return np.asarray(np.exp(STATED_SD * of_name.get(name, nothing)))

        return Laws(
            scale=self._scale(u),
            correlated=self._share(of_name[self.CORRELATED])
            if self.CORRELATED in of_name
            else nothing,
            reach=statement.reach_median * np.exp(reach_sd * reach),
            level=size(self.RUN),
            seat=size(self.SEAT),
            stated_level=factor(self.STATED_RUN),
            stated_seat=factor(self.STATED_SEATING),
            course=size(self.COURSE),
        )

    def _scale(self, u: Array) -> Array:
        """Noise (L, groups) of single readings over the stated one."""
        if self.is_common:
            by_group = (
                u[:, 1 : 1 + self.groups] if self.groups > 1 else np.zeros((1, 1))
            )
            log = ASSUMED_SCALE_SD * u[:, :1] + SCALE_SD * heavy_scale(by_group)
            return np.asarray(np.exp(log))
        by_group = u[:, : self.groups]
        if self.statement.is_assumed:
            return np.asarray(np.exp(ASSUMED_SCALE_SD * by_group))
        return scale_over_stated(by_group)

    def _share(self, u: Array) -> Array:
        """Share (L,) of the variance that is correlated.

        Where nothing is stated it has the arcsine law, Jeffreys' prior of a share: all is
        correlated, nothing is, or anything between. A prior about a middle value made the
        intervals too narrow where all is. Otherwise its logit is normal.
        """
        stated = self.statement.correlated
        if stated is None and self.is_sparse:
            middle = scipy.special.logit(SPARSE_SHARE)
            return np.asarray(scipy.special.expit(middle + SPARSE_SHARE_SD * u))
        if stated is None:
            share = np.sin(0.5 * np.pi * scipy.special.ndtr(u)) ** 2
        else:
            middle = scipy.special.logit(np.clip(stated, MIN_SHARE, 1.0 - MIN_SHARE))
            share = scipy.special.expit(middle + STATED_SHARE_SD * u)
        return np.asarray(np.clip(share, MIN_SHARE, 1.0 - MIN_SHARE))

    def starts(self) -> Array:
        """Coordinates (s, d) from which the most probable law is sought.

        The middle of the prior, an error that is correlated far, and one that is so
        over a few readings alone: each may be a mode of its own.
        """
        if self.CORRELATED not in self.names:
            return np.zeros((1, self.dimensions))
        starts = np.zeros((3, self.dimensions))
        columns = [self.names.index(self.CORRELATED), self.names.index(self.REACH)]
        starts[1, columns] = 1.5, 0.5
        starts[2, columns] = 2.5, -1.5
        return starts


def scale_over_stated(u: Array) -> Array:
    """Noise of single readings over the stated one, at normal coordinates."""
    return np.asarray(np.exp(SCALE_SD * heavy_scale(u)))


def heavy_scale(u: Array) -> Array:
    """Log noise over stated, in SCALE_SD: heavier-tailed than normal u."""
    bounded = np.maximum(u, MIN_COORDINATE)
    return np.asarray(bounded * (1.0 + (bounded / HEAVY_FROM) ** 2))


def log_prior_of_scale(scale: Array, *, is_assumed: bool) -> Array:
    """Log density (n,) of scales over the stated noise, by `heavy_scale`."""
    if is_assumed:
        return -0.5 * (np.log(scale) / ASSUMED_SCALE_SD) ** 2
    half = np.log(scale) / SCALE_SD
    third = HEAVY_FROM**2 / 3.0
    root = np.sqrt((0.5 * HEAVY_FROM**2 * half) ** 2 + third**3)
    shift = 0.5 * HEAVY_FROM**2 * half
    u = np.cbrt(shift + root) + np.cbrt(shift - root)
    return np.asarray(-0.5 * u**2)
