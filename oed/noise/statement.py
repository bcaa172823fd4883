"""What a data sheet or a test states of the noise beyond the scatter of readings."""

import dataclasses

REACH_MEDIAN = 8.0  #: reach of correlated noise, in readings, where none is stated


@dataclasses.dataclass(frozen=True, slots=True)
class NoiseStatement:
    """Stated parts of the noise; None (or absent) for a part that nothing is known of.

    A stated amount is the middle of a narrow prior, exactly 0 takes the part out of the
    model, and what is not stated has a wide prior (`oed.noise_law.prior`).
    """

    #: names of the channels whose `Channel.shared` is all that the level of a run moves
    #: by
    levels: frozenset[str] = frozenset()
    #: standard deviation of each unknown that a run seats anew, SI
    seating: float | None = None
    #: share (0 to 1) of the variance of single readings that is correlated along a run
    correlated: float | None = None
    reach: float | None = None  #: of that correlation, in readings
    #: degrees of freedom of single readings' Student t
    student_dof: float | None = None
    #: share (0 to 1) of the readings that are far off; 0: none is
    outlier_share: float | None = None
    #: whether nobody measured the stated scatter of single readings
    is_assumed: bool = False
    has_course: bool = True  #: whether readings may share a course through the session

    @property
    def correlated_share(self) -> float:
        """The stated share that is correlated, 0 where none is stated."""
        return self.correlated or 0.0

    @property
    def reach_median(self) -> float:
        """The stated reach, or what is usual, in readings."""
        return self.reach or REACH_MEDIAN


NOTHING_STATED = NoiseStatement()  #: nothing is stated but the scatter of readings
